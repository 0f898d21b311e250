"""Pictures of surfaces without a display: VTK through EGL or OSMesa, nothing on stderr."""

from __future__ import annotations

import ctypes
import os
import sys
from types import ModuleType

from femu_piezo.errors import InputError

#: Debian packages that bring a software renderer.
RENDER_PACKAGES = "libegl1 libgl1-mesa-dri"
_WINDOWS = (("libEGL.so.1", "vtkEGLRenderWindow"), ("libOSMesa.so.8", "vtkOSOpenGLRenderWindow"))


def pyvista_off_screen() -> ModuleType:
    """pyvista, set up to render without a display.

    Raises InputError where this machine has no library to render with; the sentence names the packages.
    """
    if sys.platform.startswith("linux") and "VTK_DEFAULT_OPENGL_WINDOW" not in os.environ:
        window = next((name for library, name in _WINDOWS if _loads(library)), None)
        if window is None:
            raise InputError(
                "mode pictures need a library to draw with, and neither libEGL nor libOSMesa is on this machine; on "
                f"Debian or Ubuntu: apt-get install {RENDER_PACKAGES}"
            )
        os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = window  # read by VTK when the first window is made
    import pyvista
    import vtk

    vtk.vtkObject.GlobalWarningDisplayOff()
    pyvista.OFF_SCREEN = True
    return pyvista


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
