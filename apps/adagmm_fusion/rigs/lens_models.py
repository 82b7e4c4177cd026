"""What programs call their lens models: coefficients of another model than OpenCV's (Brown-Conrady) are never read as
its own."""

import re
from typing import Any

# OpenCV's model by the names that ROS, Kalibr, RealSense, COLMAP and others have for it or a part of it.
OPENCV = re.compile(
    r"plumb_?bob|rational|brown|rad(ial)?[-_ ]?tan|opencv|pinhole|perspective|simple_?radial|^radial$|standard|"
    r"thin_?prism|tilted|^none$|^$",
    re.IGNORECASE,
)
FISHEYE = re.compile(
    r"fish_?eye|equi_?dist|kannala|^kb_?\d?$|omni|^mei$|unified|eucm|double_?sphere|^ds$|f[-_]?theta|^fov$|scaramuzza|"
    r"spherical|equirect|equisolid|stereographic",
    re.IGNORECASE,
)
# RealSense's inverse maps distorted to undistorted points, and its modified one adds the parts in another order.
OTHER_BROWN = re.compile(r"(inverse|modified)[-_ ]?brown", re.IGNORECASE)
# Names of fields, small and without underscores. `model` may also be that of the device.
STATES_DISTORTION = ("distortionmodel", "distortiontype", "lensmodel")
MAY_STATE_MODEL = ("model", "cameramodel", "cameratype", "camera.type", "cameramodeltype", "projection", "lens")
SAYS_NO = ("", "0", "no", "none", "false", "off")


def is_opencv_model(name: str) -> bool:
    """Whether a lens model of this name has OpenCV's coefficients."""
    return not (FISHEYE.search(name) or OTHER_BROWN.search(name)) and OPENCV.search(name) is not None


def other_lens_model(values: dict[str, Any], distorts: bool) -> str | None:
    """What is wrong with the lens model that fields by plain name state, or None.

    distorts : whether there are coefficients that are not zero. Without any, the model of the distortion says nothing:
        drivers name that of the lens with images they have undistorted. A camera that is a fisheye stays one.
    """
    for name, value in values.items():
        if "fisheye" in name and _is_yes(value):
            return _refusal(name, value)
        if not isinstance(value, str):
            continue
        stated = name.rsplit(".", 1)[-1] in STATES_DISTORTION
        if not stated and name not in MAY_STATE_MODEL:
            continue
        of_camera = not stated and FISHEYE.search(value)
        another = OTHER_BROWN.search(value) or (stated and not is_opencv_model(value))
        if of_camera or (distorts and another):
            return _refusal(name, value)
    return None


def wanted_model(got: Any) -> str:
    """The end of a message about a lens model that is not OpenCV's."""
    return f"expected plumb_bob or rational_polynomial, got {got}; calibrate with one of these models"


def _refusal(name: str, value: Any) -> str:
    return f"{name}: {wanted_model(repr(value)[:40])}, or undistort the images first"


def _is_yes(value: Any) -> bool:
    if isinstance(value, str):
        return value.strip().lower() not in SAYS_NO
    return any(map(_is_yes, value)) if isinstance(value, list) else bool(value)
