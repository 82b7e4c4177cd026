"""What two frames measure of the pose between them, pixel by pixel and feature by feature, and the pose of it all."""
