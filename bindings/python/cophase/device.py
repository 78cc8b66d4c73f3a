"""Devices of this machine."""

from ._library import lib, library_text


def devices() -> dict[str, str]:
    """Devices of this machine: a description of each, by the name that :class:`cophase.Session` takes.

    The first is always the CPU, ``"cpu"``. OpenCL devices are ``"opencl:PLATFORM:DEVICE"``.
    """
    return dict(line.split("\t", 1) for line in library_text(lib.cophase_device_list).split("\n"))
