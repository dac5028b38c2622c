"""Configuration of the documentation: `make docs` builds docs/_build/html. Nothing is fetched."""

import os
import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

# Notebooks run the `lampest` command of this Python, with one thread each.
os.environ["PATH"] = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
os.environ.setdefault("OMP_NUM_THREADS", "1")

project = "lampest"
author = "The lampest developers"
project_copyright = f"2026, {author}"
release = version_of("lampest")
extensions = [
    "myst_nb",
    "sphinx_gallery.gen_gallery",
    "sphinx_copybutton",
    "sphinx_design",
    "mathml",
    "generated",
]
exclude_patterns = ["_build", "examples", "gallery/*.ipynb"]
nitpicky = True

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4  # headings are linked to as on GitHub
smartquotes_action = "q"  # two dashes begin an option
highlight_language = "none"  # of blocks that name none: commands, YAML with a gap

nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_show_tb = True
nb_execution_in_temp = True
nb_merge_streams = True
toc_object_entries_show_parents = "hide"

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "image_scrapers": ("figures.scraper",),
    # a notebook shows the figure; the gallery has its own picture of it
    "ignore_repr_types": r"ShownFigure",
    "download_all_examples": False,
    "show_memory": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,  # no times: they are this machine's
}

html_theme = "furo"
html_title = "lampest"
html_static_path = ["_static"]
html_css_files = ["lampest.css"]
html_show_sourcelink = False
html_copy_source = False
html_math_renderer = "mathml"
copybutton_prompt_text = "$ "
