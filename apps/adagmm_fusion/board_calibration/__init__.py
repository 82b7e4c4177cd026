"""A rig's calibration from images of a flat board that its sensors see; calibration/README.md says how to take them."""
