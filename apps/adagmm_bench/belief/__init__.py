"""What `details.belief` is fitted on: generated pairs, their outcomes, and the regression."""
