"""Versions of what is installed, whichever package brings it."""

from importlib import metadata

# The same modules come in any of several packages.
ALSO = {
    "open3d": ("open3d-cpu",),
    "opencv-python-headless": ("opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python"),
}


def package_version(name: str) -> str:
    """The version of a package, or of another one that brings its modules; "absent" where there is none."""
    for package in (name, *ALSO.get(name, ())):
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return "absent"
