"""Where sessions run."""

from ._library import lib, text_of


def devices() -> dict[str, str]:
    """The devices of this machine: what each is, by the name that :class:`cophase.Session` takes.

    The CPU chain, ``"cpu"``, is always there, and the first. OpenCL devices are ``"opencl:PLATFORM:DEVICE"``.
    """
    return dict(line.split("\t", 1) for line in text_of(lib.cophase_device_list).split("\n"))
