"""The documentation: sphinx-build -W --keep-going -b html docs docs/_build/html

Tutorials are executed as notebooks, once for each state of the package (the results are kept in docs/_build); those on
measured sweeps only where FEMU_PIEZO_MEASURED names the folder of the data. Without executing anything:
-D nb_execution_mode=off.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "_extensions"), str(HERE.parent)]

import nicegui  # noqa: E402, F401 (before autodoc, whose imports see TYPE_CHECKING as true, which pydantic does not stand)

import femu_piezo  # noqa: E402
from femu_piezo.files import SCHEMA  # noqa: E402

project = "femu_piezo"
author = "the authors of femu_piezo"
version = release = femu_piezo.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx_design",
    "plain_docstrings",
    "schema_tables",
]
exclude_patterns = [
    "_build",
    "_extensions",
    "*.py",
    "reference/modules/modules.rst",
    "tutorials/*.py",
    "tutorials/*/make_sweep.py",
    "tutorials/*/effects",
    "**/__pycache__",
    "**/out",
]

# --- pages

html_theme = "pydata_sphinx_theme"
html_title = f"femu_piezo {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_sidebars = {page: [] for page in ("index", "validation", "performance", "changelog")}
html_copy_source = False
html_theme_options = {
    "navbar_align": "left",
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "footer_start": [],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}

# --- text

source_suffix = {".rst": "restructuredtext", ".md": "myst-nb", ".py": "myst-nb"}
myst_enable_extensions = ["colon_fence", "deflist", "fieldlist", "substitution"]
myst_heading_anchors = 4
myst_substitutions = {"schema": SCHEMA}

# --- reference

apidoc_modules = [
    {
        "path": "../femu_piezo",
        "exclude_patterns": ["**/store/migrations/*"],  # run by Alembic, in an environment of its own
        "destination": "reference/modules",
        "separate_modules": True,
        "implicit_namespaces": True,
        "module_first": True,
        "automodule_options": {"members", "show-inheritance"},
    }
]
autodoc_default_options = {"members": True, "show-inheritance": True, "ignore-module-all": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
napoleon_custom_sections = [("What the choices do", "params_style")]
default_role = "literal"
smartquotes = False
suppress_warnings = ["ref.python"]  # names of attributes, which many classes share, are no links
add_module_names = False
toc_object_entries = False

# --- tutorials

# Sphinx reads what lies below this folder, and a link in a page of a folder linked in from elsewhere leads nowhere.
_unwanted = shutil.ignore_patterns("__pycache__", "out")
shutil.copytree(HERE.parent / "tutorials", HERE / "tutorials", dirs_exist_ok=True, ignore=_unwanted)
_OUT = HERE / "_build" / "tutorials"
_OUT.mkdir(parents=True, exist_ok=True)
os.environ["FEMU_PIEZO_OUT"] = str(_OUT)
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
nb_custom_formats = {".py": ["tutorial_notebooks.read", {}]}
nb_execution_mode = "cache"
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
if "FEMU_PIEZO_MEASURED" not in os.environ:
    nb_execution_excludepatterns = ["tutorials/measured_*/*"]
