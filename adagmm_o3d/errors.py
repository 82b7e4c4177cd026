"""Every error this package raises derives from `AdaGMMError`; each also is what Python users already catch."""


class AdaGMMError(Exception):
    """Base of all errors raised on purpose by adagmm_o3d and its apps."""


class InputError(AdaGMMError, ValueError):
    """An argument or a file has the right type and a value that cannot be used."""


class InputTypeError(AdaGMMError, TypeError):
    """An argument has the wrong type or dtype."""


class DegenerateError(InputError):
    """The clouds leave the pose undetermined: too few points, or points on one line."""


class DeviceError(AdaGMMError, RuntimeError):
    """The requested device does not exist or cannot run the kernels."""


class MissingLibraryError(AdaGMMError, ImportError):
    """A library that this needs is not installed or cannot be loaded; the message says how to get it."""
