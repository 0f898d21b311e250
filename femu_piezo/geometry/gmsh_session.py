"""A gmsh session through pygmsh that prints nothing, keeps the signal handlers and leaves no state behind."""

from __future__ import annotations

import contextlib
import ctypes
import io
import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import RLock

import meshio

from femu_piezo.errors import InputError

#: Debian packages with the shared libraries that the gmsh wheel loads (ldd libgmsh.so, 4.15).
GMSH_PACKAGES = "libglu1-mesa libgl1 libgomp1 libxrender1 libxcursor1 libxft2 libxinerama1"


def _ignore_broken_pipes() -> None:
    """Ignore SIGPIPE again, as Python does to raise BrokenPipeError; gmsh resets it, so that it would end the process.

    The C call works in every thread, which the workers of a cluster need.
    """
    if hasattr(signal, "SIGPIPE") and signal.getsignal(signal.SIGPIPE) == signal.SIG_IGN:
        setsig = ctypes.pythonapi.PyOS_setsig
        setsig.argtypes, setsig.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
        setsig(signal.SIGPIPE, int(signal.SIG_IGN))


#: gmsh has one session per process: threads that mesh at the same time take turns.
_turn = RLock()


@contextmanager
def gmsh_session(kernel: str = "occ") -> Iterator:
    """Yield a pygmsh geometry ("occ" or "geo"); the raw model is `gmsh.model`.

    Raises
    ------
    InputError : gmsh cannot be loaded (the sentence names the system packages)
    """
    try:
        import gmsh
        import pygmsh
    except (ImportError, OSError) as error:
        raise InputError(
            f"gmsh cannot be loaded on this machine ({error}), and this shape needs it to be meshed; on Debian or "
            f"Ubuntu: apt-get install {GMSH_PACKAGES} (plain rectangular plates do without)"
        ) from None
    with _turn:
        if gmsh.isInitialized():
            raise InputError(
                "another gmsh session is open in this process; call gmsh.finalize() before meshing a shape"
            )
        geometry = (pygmsh.occ if kernel == "occ" else pygmsh.geo).Geometry()
        # pygmsh would read the user's gmsh settings and take over Ctrl-C, so the session is opened here
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        _ignore_broken_pipes()
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.option.setNumber("General.NumThreads", 1)
            gmsh.model.add("specimen")
            yield geometry
        finally:
            gmsh.finalize()


def mesh_drawing(
    build: Callable[[object], None], options: Mapping[str, float], what: str, dimension: int = 3
) -> meshio.Mesh:
    """Mesh the solid, or in dimension 2 the surface, that `build(gmsh)` draws with the OpenCASCADE kernel.

    Parameters
    ----------
    options : gmsh options, e.g. {"Mesh.MeshSizeMax": 1e-3}
    what : the shape in words, for messages

    Raises
    ------
    InputError : gmsh is missing, or cannot draw or mesh the shape
    """
    with gmsh_session(), tempfile.TemporaryDirectory() as folder:
        import gmsh
        import pygmsh

        path = Path(folder) / "solid.msh"
        try:
            build(gmsh)
            gmsh.model.occ.synchronize()
            for name, value in options.items():
                gmsh.option.setNumber(name, value)
            gmsh.model.mesh.generate(dimension)
            gmsh.option.setNumber("Mesh.Binary", 1)
            pygmsh.write(str(path))
        except InputError:
            raise
        except Exception as error:  # gmsh raises plain Exception for everything
            raise InputError(f"gmsh cannot mesh {what}: {error}; check its dimensions against each other") from None
        with contextlib.redirect_stdout(io.StringIO()):  # meshio prints an empty line
            return meshio.read(path)
