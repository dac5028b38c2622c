"""Manifests of the C library: rules of arduino-lint's specification, and of PlatformIO's.

https://arduino.github.io/arduino-cli/latest/library-specification/ and
https://docs.platformio.org/en/latest/manifests/library-json/.
"""

import json
import re

import pytest

from lampest.apps.microcontroller.library import library_folder, library_version, sources

REQUIRED = ("name", "version", "author", "maintainer", "sentence", "paragraph", "category")
CATEGORIES = (
    "Display",
    "Communication",
    "Signal Input/Output",
    "Sensors",
    "Device Control",
    "Timing",
    "Data Storage",
    "Data Processing",
    "Other",
)
OPTIONAL = (
    "url",
    "architectures",
    "depends",
    "dot_a_linkage",
    "includes",
    "precompiled",
    "ldflags",
)
MAX_NAME = 63  # characters
FOLDERS = (library_folder(), library_folder().parent / "lampest_board")
FIELDS_OF_PLATFORMIO = {
    "name": str,
    "version": str,
    "description": str,
    "keywords": (str, list),
    "homepage": str,
    "license": str,
    "frameworks": (str, list),
    "platforms": (str, list),
    "headers": (str, list),
    "examples": list,
    "build": dict,
}


def properties(folder):
    lines = (folder / "library.properties").read_text(encoding="utf-8").splitlines()
    return dict(line.split("=", 1) for line in lines)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_library_properties_follow_the_specification(folder):
    about = properties(folder)
    assert all(about[field].strip() == about[field] != "" for field in REQUIRED)
    assert set(about) <= {*REQUIRED, *OPTIONAL}
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 _.-]*", about["name"])
    assert len(about["name"]) <= MAX_NAME and "arduino" not in about["name"].lower()
    assert about["name"] == folder.name
    assert re.fullmatch(r"\d+\.\d+\.\d+", about["version"])
    assert about["category"] in CATEGORIES
    assert not about["paragraph"].startswith(about["sentence"])
    assert all((folder / name).is_file() for name in about["includes"].split(","))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_an_example_is_a_sketch_in_a_folder_of_its_name(folder):
    examples = [path for path in (folder / "examples").iterdir() if path.is_dir()]
    assert examples
    assert all((example / f"{example.name}.ino").is_file() for example in examples)


def test_the_manifest_of_platformio_names_the_sources_and_known_fields():
    about = json.loads((library_folder() / "library.json").read_text(encoding="utf-8"))
    assert {"name", "version", "license"} <= set(about) <= set(FIELDS_OF_PLATFORMIO)
    assert all(isinstance(value, FIELDS_OF_PLATFORMIO[field]) for field, value in about.items())
    assert re.fullmatch(r"[a-z0-9_]+", about["name"])
    assert set(about["build"]) <= {"srcDir", "srcFilter", "flags", "includeDir"}
    assert (library_folder() / about["headers"]).is_file()


def test_header_and_manifests_name_one_version():
    major, minor, patch = properties(library_folder())["version"].split(".")
    about = json.loads((library_folder() / "library.json").read_text(encoding="utf-8"))
    assert about["version"] == f"{major}.{minor}.{patch}"
    assert library_version() == 10_000 * int(major) + 100 * int(minor) + int(patch)


def test_every_header_is_guarded_and_every_source_includes_existing_files():
    names = {path.name for path in sources()}
    for path in sources():
        text = path.read_text(encoding="utf-8")
        assert set(re.findall(r'#include "([^"]+)"', text)) <= names
        if path.suffix == ".h":
            guard = f"LAMPEST_{path.stem.removeprefix('lampest_').upper()}_H"
            assert f"#ifndef {guard}\n#define {guard}" in text
