"""Applications of the core: folders of `lampest/apps`, and objects of installed packages.

The core imports no application. It asks an application by its name, and works without it.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

from lampest.files.errors import InputError

FOLDER = Path(__file__).parents[1] / "apps"
GROUP = "lampest.applications"  # of entry points, for applications of other packages
# Groups of entry points to which applications add, too, and the field that names their objects.
GROUPS = {
    "lampest.exports": "exports",
    "lampest.plots": "figures",
    "lampest.columns": "columns",
}


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command of an application.

    Attributes
    ----------
    part : str
        Heading of the help under which it stands, such as 'Look'.
    target : str
        'module:function'. Parameters of the function are options; its docstring is the help.
    example : str
        Arguments of an example.
    """

    part: str
    target: str
    example: str = ""


@dataclass(frozen=True, kw_only=True)
class Application:
    """Everything that one application adds to lampest. Objects are named as 'module:object'.

    Attributes
    ----------
    name : str
        Its word, as sentences have it.
    about : str
        The question that it answers.
    needs : tuple of str
        Names of the applications that it imports.
    commands : mapping of str to Command
        By their words: 'midi', or 'study bench' for a command of a group.
    groups : mapping of str to str
        Help of its groups of commands.
    scene_keys : mapping of str to str
        'module:Class' by a key at the top of a scene. The class is a frozen dataclass derived from
        `lampest.files.typed.Configuration`; `Scene.own` returns its object.
    exports, figures, columns : tuple of str
        Objects of `lampest export --to`, `lampest plot --show` and results files, as
        docs/howto/adding describes them.
    advice : str
        Function from a recording to rows (heading, sentence) of `lampest info`; '' for none.
    answers : mapping of str to str
        Answers to questions of the core, by name.

    >>> from lampest.files.applications import Application
    >>> Application(name="midi", about="notes of pressed cells").commands
    {}
    """

    name: str
    about: str
    needs: tuple[str, ...] = ()
    commands: Mapping[str, Command] = field(default_factory=dict)
    groups: Mapping[str, str] = field(default_factory=dict)
    scene_keys: Mapping[str, str] = field(default_factory=dict)
    exports: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    advice: str = ""
    answers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Applications:
    """Installed applications.

    Attributes
    ----------
    usable : mapping of str to Application
        By name, those of the package before those of installed packages.
    objections : tuple of str
        A sentence for each application of an installed package that cannot be used.
    """

    usable: Mapping[str, Application]
    objections: tuple[str, ...]

    def provided(self, application: str, answer: str) -> Any:
        """Return an application's answer to a question of the core, or None without it."""
        asked = self.usable.get(application)
        return None if asked is None else loaded(asked.answers[answer])

    def required(self, application: str, answer: str, because: str) -> Any:
        """Return an application's answer to a question of the core.

        Raises InputError with the reason `because` if the application is not installed.
        """
        self.require(application, because)
        return self.provided(application, answer)

    def require(self, application: str, because: str) -> None:
        """Raise InputError with the reason `because` if an application is not installed."""
        if application not in self.usable:
            raise InputError(f"{because}: the application '{application}' is not installed")

    def members(self, group: str) -> tuple[Any, ...]:
        """Return the objects that applications add to a group of entry points."""
        named = GROUPS[group]
        targets = (target for each in self.usable.values() for target in getattr(each, named))
        return tuple(map(loaded, targets))

    @property
    def scene_keys(self) -> dict[str, str]:
        """'module:Class' of the objects of scenes' keys, by key."""
        targets = dict[str, str]()
        for each in self.usable.values():
            targets |= each.scene_keys
        return targets

    def advice(self, recording: Any) -> list[tuple[str, str]]:
        """Return the rows (heading, sentence) that applications add to a recording's `info`."""
        functions = (loaded(each.advice) for each in self.usable.values() if each.advice)
        return [row for function in functions for row in function(recording)]


@cache
def applications() -> Applications:
    """Return the applications that are installed, with the applications that they need."""
    usable = {}
    for path in sorted(FOLDER.glob("*/__init__.py")):
        usable[path.parent.name] = import_module(f"lampest.apps.{path.parent.name}").APPLICATION
    objections = []
    for point in entry_points_of(GROUP):
        named = f"{GROUP}: {point.name} = {point.value} of an installed package"
        try:
            application = point.load()
        except Exception as error:  # any error of the package while it is imported
            objections.append(f"{named} cannot be loaded ({error})")
            continue
        if not isinstance(application, Application):
            objections.append(f"{named} is no Application")
        elif application.name in usable:
            objections.append(f"{named}: there is an application '{application.name}' already")
        else:
            usable[application.name] = application
    while incomplete := [each for each in usable.values() if not usable.keys() >= {*each.needs}]:
        for application in incomplete:
            missing = ", ".join(name for name in application.needs if name not in usable)
            del usable[application.name]
            if not (FOLDER / application.name).is_dir():  # of a package; a folder was deleted
                objections.append(f"the application '{application.name}' needs {missing}")
    return Applications(usable, tuple(objections))


def entry_points_of(group: str) -> list[Any]:
    """Return the entry points of a group, ordered by name.

    A search for the group's name in the entry point files of installed packages comes first,
    because Python's own search takes longer than a command needs to print its help.
    """
    places = [Path(place or ".") for place in sys.path]
    files = (file for place in places for file in place.glob("*-info/entry_points.txt"))
    if not any(group in file.read_text(encoding="utf-8", errors="replace") for file in files):
        return []
    from importlib.metadata import entry_points  # with email and zipfile

    return sorted(entry_points(group=group), key=lambda point: point.name)


def loaded(target: str) -> Any:
    """Return the object that 'module:object' names."""
    module, _, name = target.partition(":")
    return attrgetter(name)(import_module(module))
