"""A recording without a sensor: ray casting of a textured room, seen by two Kinects whose defects are modelled."""
