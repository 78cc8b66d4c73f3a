"""Factories of sessions, for processes that share work."""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass, fields

from ._library import absolute, read_scene
from .model import Model
from .session import Session

_lock = threading.Lock()
_models: dict[tuple[str, str], Model] = {}
_local = threading.local()


@dataclass(frozen=True)
class SessionFactory:
    """What makes sessions of one scene in any process: it pickles, and is a few lines of text.

    Called, it returns the session of the calling thread, which is made at the first call and kept: a process builds one
    model, and each of its threads one session, for however many frames. Equal factories share them.

    Parameters
    ----------
    scene : str or path
        Scene: a TOML file, the name of a preset (:func:`cophase.preset`), or TOML text. The factory holds its text.
    directory : path, optional
        Directory of the files that the scene names; that of the scene's file, or else the working directory of the
        process that makes the factory, by default.
    device, capacity, precision, threads, max_evaluations, step_tolerance_nm : optional
        As for :class:`cophase.Session`.

    Examples
    --------
    >>> factory = cophase.SessionFactory(cophase.preset("keck-artificial"))
    >>> def coefficients_nm(frame):
    ...     return factory().fit(frame).coefficients_nm
    >>> with concurrent.futures.ProcessPoolExecutor() as pool:      # or client.map of Dask
    ...     found_nm = list(pool.map(coefficients_nm, frames))
    """

    scene: str | os.PathLike[str]
    directory: str | os.PathLike[str] | None = None
    device: str | None = None
    capacity: int = 1
    precision: str | None = None
    threads: int = 1
    max_evaluations: int | None = None
    step_tolerance_nm: float | None = None

    def __post_init__(self) -> None:
        scene_text, directory = read_scene(self.scene, self.directory)
        object.__setattr__(self, "scene", scene_text)
        # Another process has another working directory.
        object.__setattr__(self, "directory", absolute(directory))

    def model(self) -> Model:
        """The model of this process."""
        key = (str(self.scene), str(self.directory))
        with _lock:
            if key not in _models:
                _models[key] = Model(self.scene, self.directory)
            return _models[key]

    def __call__(self) -> Session:
        """The session of this thread."""
        sessions: dict[SessionFactory, Session] = _local.__dict__.setdefault("sessions", {})
        if self not in sessions:
            own = {field.name: getattr(self, field.name) for field in fields(self)}
            del own["scene"], own["directory"]
            sessions[self] = Session(self.model(), **own)
        return sessions[self]
