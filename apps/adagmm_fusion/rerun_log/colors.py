"""The colours that mean the same in every view."""

TARGET_COLOR = (60, 130, 246)
SOURCE_COLOR = (255, 140, 40)
TRUTH_COLOR = (40, 200, 90)
INITIAL_COLOR = (110, 160, 255)
TARGET_CAMERA_COLOR = (220, 220, 220)
