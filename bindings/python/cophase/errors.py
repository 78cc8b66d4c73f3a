"""What can go wrong in the library: an exception for every status of its calls.

What Python itself can see, a wrong type for instance, is a ``TypeError`` or a ``ValueError`` as anywhere in Python.
"""


class Error(RuntimeError):
    """A call that failed, in the library's own sentence. Its subclasses are one for each status.

    Attributes
    ----------
    status : str
        The name of the status, such as ``"BAD_SCENE"``.
    """

    status: str = "UNKNOWN"


class BadSceneError(Error):
    """A scene that cannot be parsed, or that names something impossible."""

    status = "BAD_SCENE"


class BadFileError(Error):
    """A file that cannot be read or written."""

    status = "BAD_FILE"


class BadShapeError(Error):
    """An array whose shape does not fit."""

    status = "BAD_SHAPE"


class BadValueError(Error):
    """A number out of its range, or a call that comes too early."""

    status = "BAD_VALUE"


class BadImageError(Error):
    """An image that holds nothing to fit."""

    status = "BAD_IMAGE"


class DeviceError(Error):
    """OpenCL is absent, or a device failed."""

    status = "DEVICE"


class Interrupted(Error):
    """Somebody asked to stop: see :meth:`cophase.Session.cancel`."""

    status = "INTERRUPTED"


class InternalError(Error):
    """A broken promise of the library's own; please report it."""

    status = "INTERNAL"


class BadArgumentError(Error):
    """An argument that cannot be used, such as an object that was closed."""

    status = "BAD_ARGUMENT"


class BusyError(Error):
    """The object is in use by another thread; nothing was done."""

    status = "BUSY"


class PanicError(Error):
    """The library panicked, now or earlier, in a call on this object: it can only be closed. Please report it."""

    status = "PANIC"
