"""The figure that an example script draws → its picture in the gallery."""

from typing import Any

from sphinx_gallery.scrapers import figure_rst


def scraper(block: Any, variables: dict[str, Any], settings: dict[str, Any]) -> str:
    """The script's variable `figure` as PNG, once it is there."""
    figure = variables["example_globals"].pop("figure", None)
    if figure is None:
        return ""
    path = next(variables["image_path_iterator"])
    figure.savefig(path, dpi=110, bbox_inches="tight")
    return figure_rst([path], settings["src_dir"])
