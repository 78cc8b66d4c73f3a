"""Failures of the library: an exception for every status of its calls.

Errors that Python itself detects, a wrong type for instance, are a ``TypeError`` or a ``ValueError``.
"""


class Error(RuntimeError):
    """Call that failed, with the library's sentence. There is a subclass for each status.

    Attributes
    ----------
    status : str
        Name of the status, such as ``"BAD_SCENE"``.
    """

    status: str = "UNKNOWN"


class BadSceneError(Error):
    """Scene that cannot be parsed, or with an impossible value."""

    status = "BAD_SCENE"


class BadFileError(Error):
    """File that cannot be read or written."""

    status = "BAD_FILE"


class BadShapeError(Error):
    """Array of the wrong shape."""

    status = "BAD_SHAPE"


class BadValueError(Error):
    """Number out of range, or a call before the one that it needs."""

    status = "BAD_VALUE"


class BadImageError(Error):
    """No usable image."""

    status = "BAD_IMAGE"


class DeviceError(Error):
    """No OpenCL device, or a device that failed."""

    status = "DEVICE"


class Interrupted(Error):
    """Call stopped by a cancel call: see :meth:`cophase.Session.cancel`."""

    status = "INTERRUPTED"


class InternalError(Error):
    """Error of the library itself; please report it."""

    status = "INTERNAL"


class BadArgumentError(Error):
    """Unusable argument, such as an object that was closed."""

    status = "BAD_ARGUMENT"


class BusyError(Error):
    """Object in use by another thread; nothing was done."""

    status = "BUSY"


class PanicError(Error):
    """Panic inside the library, now or earlier, in a call on this object. It can only be closed; please report it."""

    status = "PANIC"
