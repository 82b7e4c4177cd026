"""What looks wrong in a camera's intrinsics alone: a principal point that is another image's, pixels not square."""

from adagmm_fusion.frames.rgbd import PinholeIntrinsics

# A principal point further from the middle than this share of the image is doubted: a RealSense F200 and a Kinect v1
# have it 3.3 % off, and undistorted images of 739x458 9.2 %.
OFF_MIDDLE = 0.095
# The depth images of the Azure Kinect's narrow view are a part of its 1024 x 1024, from the row 180 on.
AZURE_MIDDLES = {(640, 576): (319.5, 331.5), (320, 288): (159.5, 165.5)}
# Where both of cx and cy are off by more than this share of the image, and neither would be if exchanged, they are.
EXCHANGED = 0.1
# Cameras' fx and fy are within 1 %.
SQUARE = 1.2
LOOK_EXCHANGED = "look exchanged"


def look_exchanged(width: int, height: int, cx: float, cy: float) -> bool:
    """Whether cx would rather be cy, and the other way round."""
    off, exchanged = (
        (abs(x / width - 0.5) > EXCHANGED, abs(y / height - 0.5) > EXCHANGED) for x, y in ((cx, cy), (cy, cx))
    )
    return all(off) and not any(exchanged)


def principal_point_doubt(k: PinholeIntrinsics) -> str | None:
    """What to say of a principal point that is far from the image's middle."""
    if look_exchanged(k.width, k.height, k.cx, k.cy):
        return f"cx {k.cx:g} cy {k.cy:g} {LOOK_EXCHANGED}, for images of {k.width}x{k.height}"
    middle = AZURE_MIDDLES.get((k.width, k.height), ((k.width - 1) / 2, (k.height - 1) / 2))
    off = [
        f"{name} {value:.4g} is {abs(value - at):.0f} px off the middle of images {size} {direction}"
        for name, value, at, size, direction in (
            ("cx", k.cx, middle[0], k.width, "wide"),
            ("cy", k.cy, middle[1], k.height, "high"),
        )
        if abs(value - at) > OFF_MIDDLE * size
    ]
    return f"{' and '.join(off)}: were they cropped or resized after the calibration?" if off else None


def pixels_doubt(k: PinholeIntrinsics) -> str | None:
    """What to say of fx and fy that are of pixels which are not square."""
    if max(k.fx / k.fy, k.fy / k.fx) <= SQUARE:
        return None
    return (
        f"fx {k.fx:.4g} and fy {k.fy:.4g} are of pixels that are not square, as cameras' are: is one of them wrong, or "
        "were the images stretched?"
    )
