"""Laws of every class that a user may write as YAML."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any, Literal, get_args

import numpy as np
import pytest
from laws.samples import (
    DECIDED,
    NEEDED,
    configurations,
    examples,
    hints,
    is_settled,
    members_of,
    parts,
    unions,
    words,
)

from lampest import (
    Course,
    Estimator,
    Huber,
    InputError,
    LoadedColumnsReadout,
    OralDisc,
    Panel,
    Simulation,
    Student,
    Unmodelled,
)
from lampest.apps.film.pressure import pressure_of
from lampest.cost.terms import Arrival, Gradient, Misfit, term_types
from lampest.estimate.methods import AnyMethod, MethodName, named_method
from lampest.files import typed
from lampest.files.document import (
    Document,
    adapter,
    parse_document,
    plain_content,
    to_yaml,
    validated,
)
from lampest.panel.faults import Faults
from lampest.panel.lines import SeriesPerLine
from lampest.panel.readouts import AnyReadout, TwoPointReadout
from lampest.panel.readouts.wiring import ContactPrior, Contacts
from lampest.panel.response import Film, PowerResponse, TableResponse
from lampest.panel.scene import Scene
from lampest.runs.config import Terms

KINDS = {
    f"{kind.__module__.removeprefix('lampest.')}.{kind.__name__}": kind for kind in configurations()
}
EACH_KIND = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
MEMBERS = [
    pytest.param(members, member, word, id=word)
    for members in unions()
    for member in members
    for word in words(member)
]

MAX_DEPTH = 1  # what stands deeper in an example is an example of its own


def loaded(text: str, kind: Any) -> Any:
    return validated(parse_document(text, "law"), kind)


@cache
def documents(kind: type) -> tuple[tuple[Any, Document], ...]:
    """Every example with the document that it is written as."""
    return tuple((example, parse_document(to_yaml(example), "law")) for example in examples(kind))


@EACH_KIND
def test_examples_differ_in_every_field(kind: type) -> None:
    """Without it the laws below would say little."""
    first, *variants = examples(kind)
    free = [name for name, hint in hints(kind).items() if not is_settled(hint)]
    assert len(variants) == len(free)
    for name, variant in zip(free, variants, strict=True):
        compared = kind.__dataclass_fields__[name].compare
        if name in DECIDED or name in NEEDED or not compared:
            assert getattr(variant, name) != getattr(first, name)
            continue
        assert dataclasses.replace(variant, **{name: getattr(first, name)}) == first != variant


@EACH_KIND
def test_a_configuration_survives_its_text(kind: type) -> None:
    for example, document in documents(kind):
        assert document.content == plain_content(example)
        assert validated(document, kind) == example, document.content


@EACH_KIND
def test_an_unknown_key_is_refused_and_named_at_any_depth(kind: type) -> None:
    every = (
        (path, document) for example, document in documents(kind) for path in places(example, ())
    )
    shallow = {path: document for path, document in every if len(path) <= MAX_DEPTH}
    for path, document in shallow.items():
        with pytest.raises(
            InputError, match=r"^law:\d+:\d+: .*surplus: no such key(; there are [a-z_0-9, ]+)?$"
        ):
            validated(document.with_value((*path, "surplus"), 1), kind)


def places(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Paths of all objects within one that are mappings in YAML; those in lists are passed over."""
    if dataclasses.is_dataclass(value):
        yield path
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places(item, (*path, key))


@EACH_KIND
def test_numbers_beyond_any_measurement_are_refused_at_any_depth(kind: type) -> None:
    """A sentence names line, column and key of the number before anything computes with it."""
    every = (
        (path, document)
        for _, document in documents(kind)
        for path in numbers(document.content, ())
    )
    shallow = {path: document for path, document in every if len(path) <= 1 + MAX_DEPTH}
    for (path, document), extreme in zip(
        shallow.items(), itertools.cycle((-1e300, 5e-324, 10**31)), strict=False
    ):
        with pytest.raises(
            InputError, match=r"^law:\d+:\d+: .*must be zero or lie between 1e-30 and 1e\+30"
        ):
            loaded(to_yaml(replaced(document.content, path, extreme)), kind)


def numbers(content: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    """Where in a document numbers stand; a seed measures nothing."""
    inner = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content)
        if isinstance(content, list)
        else ()
    )
    for key, value in inner:
        if isinstance(value, int | float) and not isinstance(value, bool) and key != "seed":
            yield (*path, key)
        yield from numbers(value, (*path, key))


def replaced(content: Any, path: tuple[Any, ...], value: float) -> Any:
    """The content with another value at a path."""
    if not path:
        return value
    changed = content.copy()
    changed[path[0]] = replaced(content[path[0]], path[1:], value)
    return changed


@EACH_KIND
def test_a_missing_key_is_refused_and_named(kind: type) -> None:
    content = plain_content(examples(kind)[0])
    for field in dataclasses.fields(kind):
        if field.default is field.default_factory:
            remaining = {name: value for name, value in content.items() if name != field.name}
            with pytest.raises(InputError, match=rf"law:1:1: {field.name}: Field required"):
                loaded(to_yaml(remaining), kind)


@EACH_KIND
def test_a_configuration_is_frozen_and_contains_only_configurations(kind: type) -> None:
    assert kind.__dataclass_params__.frozen
    assert kind.__pydantic_config__ == {"extra": "forbid"}
    inside = {
        part
        for hint in hints(kind).values()
        for part in parts(hint)
        if dataclasses.is_dataclass(part)
    }
    assert {part for part in inside if isinstance(part, type)} <= {*configurations()}


@pytest.mark.parametrize(("members", "member", "word"), MEMBERS)
def test_the_kind_distinguishes_the_members_of_a_union(
    members: tuple[type, ...], member: type, word: str
) -> None:
    """In every place that takes the union the member loads by its word, and by no other."""
    assert [alternative for alternative in members if word in words(alternative)] == [member]
    example = dataclasses.replace(examples(member)[0], kind=word)
    assert loaded(to_yaml(example), member) == example
    for alternative in members:
        if alternative is not member:
            with pytest.raises(InputError):
                loaded(to_yaml(example), alternative)


def test_every_term_goes_by_its_kind_in_an_estimator() -> None:
    assert hints(Terms) == {kind: term | None for kind, term in term_types().items()}
    for kind, term in term_types().items():
        for example in examples(term):
            assert loaded(to_yaml({kind: example}), Terms) == Terms(**{kind: example})


def test_every_method_may_be_given_by_its_name() -> None:
    methods = members_of(AnyMethod)
    assert {word for method in methods for word in words(method)} == {*get_args(MethodName)}
    for method in methods:
        assert all(named_method(word) == method(kind=word) for word in words(method))


@pytest.mark.parametrize("union", [AnyReadout, AnyMethod])
def test_classes_named_by_a_union_have_the_kinds_of_their_names(union: Any) -> None:
    named = get_args(union)[1].members
    assert named.keys() == typed.members_by_kind(union).keys()
    for kind in named:
        assert kind in typed.kinds_of(typed.member_of_kind(union, kind))


@dataclasses.dataclass(frozen=True)
class _Plain(typed.Validated):
    count: int
    size: float | None
    word: Literal["one", "two"]
    name: str
    sure: bool = False
    lines: float | tuple[float, ...] = 0.0


def test_numbers_and_texts_of_the_right_type_need_no_schema() -> None:
    """A schema takes milliseconds, and commands make hundreds of objects."""
    made = adapter.cache_info().misses
    right = {"count": 2, "size": 0.5, "word": "two", "name": "mat", "sure": True}
    right |= {"lines": (1.0, 2.5)}
    assert dataclasses.asdict(_Plain(**right)) == right
    assert _Plain(0, None, "one", "").size is None
    assert adapter.cache_info().misses == made
    wrong = {"count": 0.5, "size": 1e300, "word": "three", "name": 5, "sure": 1}
    wrong |= {"lines": (1.0, 1e300)}
    for field, value in wrong.items():
        with pytest.raises(InputError, match=rf"^_Plain: {field}: "):
            _Plain(**right | {field: value})
    assert isinstance(_Plain(2, 1, "one", "").size, float)
    assert _Plain(2, 1.0, "one", "", lines=[1.0, 2.5]).lines == (1.0, 2.5)


def test_installed_kinds_stand_in_the_order_of_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    named = {"b": Panel, "a": Scene}.items()
    points = [EntryPoint(name, f"{kind.__module__}:{kind.__name__}", "g") for name, kind in named]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points)
    assert typed.installed.__wrapped__("g", type) == (Scene, Panel)


def table(pressure: tuple[float, ...], ohm: tuple[float, ...], **options: Any) -> TableResponse:
    return TableResponse(pressure_kpa=pressure, resistance_ohm=ohm, **options)


def scene(**keys: Any) -> Scene:
    return Scene(Panel(6, 7), **keys)


NOISY = Misfit(weighting="noise")
SERIES = r"belongs to readout\.kind: two_point.*drive_ohm or sense_ohm"
SMOOTHER = r"smoother has one term, misfit: \{weighting: noise, loss"
IMPOSSIBLE: list[tuple[Callable[[], object], str]] = [
    (lambda: scene(faults=Faults(open=((6, 0),))), "there is no cell"),
    (lambda: scene(faults=Faults(dead_rows=(9,))), "there is no row 9"),
    (lambda: scene(faults=Faults(open=((1, 1),), shorted=((1, 1),))), "open and shorted"),
    (lambda: scene(faults=Faults(dead_rows=tuple(range(6)))), "nothing is left"),
    (lambda: scene(faults=Faults(joined_rows=((1,),))), "joined_rows lists groups of two or more"),
    (lambda: scene(faults=Faults(joined_rows=((1, 2), (2, 3)))), "each row once"),
    (lambda: scene(faults=Faults(joined_columns=((1, 9),))), "there is no column 9"),
    (
        lambda: scene(faults=Faults(joined_rows=((1, 2),), dead_rows=(2,))),
        "cannot be dead and joined",
    ),
    (
        lambda: scene(contacts=Contacts(ContactPrior((1.0, 2.0)))),
        "lists 2 numbers, but there are 6 such lines",
    ),
    (lambda: scene(readout=LoadedColumnsReadout(), series_resistance_ohm=140.0), SERIES),
    (
        lambda: scene(
            readout=LoadedColumnsReadout(), series_resistance_ohm=SeriesPerLine(70.0, 70.0)
        ),
        SERIES,
    ),
    (
        lambda: scene(
            readout=TwoPointReadout(), series_resistance_ohm=SeriesPerLine((80.0,) * 2, 60.0)
        ),
        "series_resistance_ohm.rows lists 2 numbers, but there are 6 such lines",
    ),
    (
        lambda: scene(response=PowerResponse(exponent=1.0, scale_kpa=1.0, gain=((1.0, 1.0),))),
        r"response\.gain must have 6 rows of 7 numbers",
    ),
    (
        lambda: TwoPointReadout(passes_volt=(3.0, 1.0)),
        "passes_volt must be two voltages from 0 to 5, the lower one",
    ),
    (lambda: loaded("hysteresis: often", Film), "hysteresis"),
    (lambda: table((0, 1, 1), (3, 2, 1)), "must rise"),
    (lambda: table((0, 1, 2), (3, 2, 2)), "must be positive, and fall"),
    (lambda: table((0, 1, 2), (3, 2)), "as many"),
    (lambda: table((1, 2), (3, 2)), "from 0 or below"),
    (lambda: table((0, 1), (3, 2), sd=(0.1,)), "sd needs one number"),
    (lambda: table((0, 1), (3, 2), gain=((1.0, 2.0), (1.0,))), "gain needs one number"),
    (lambda: table((0, 1), (3, 2), gain=((0.0,),)), "gain must be positive"),
    (lambda: dataclasses.replace(examples(OralDisc)[0], rim_kpa=9, extra_rim_kpa=1), "must"),
    (lambda: Course(pump_s=40, pump_loss=1), "pump_loss must be below 1"),
    *(
        (
            lambda effect=effect: Simulation(1, 5, scene(), unmodelled=Unmodelled(**{effect: 0.5})),
            "need a readout",
        )
        for effect in (
            *("reference_tolerance", "outlier_probability", "noise_factor", "saturation"),
            *("supply_ripple_lsb", "gain_spread", "inl_lsb"),
        )
    ),
    *(
        (
            lambda ends=ends: pressure_of(*np.multiply.outer(ends, np.ones((1, 6, 7))), scene()),
            "positive, finite and",
        )
        for ends in ((0.0, 0.0, 1.0), (1.0, 1.1, 2.0), (np.inf, 1.0, np.inf))
    ),
    (lambda: pressure_of(*np.ones((3, 1, 5, 7)), scene()), "frames × rows × columns"),
    (lambda: Estimator((Misfit(),), tare=10), "tare must be"),
    (
        lambda: Estimator((NOISY, Arrival()), error_bars=False),
        "arrival weighs frames by their error bars",
    ),
    (
        lambda: Estimator((NOISY, Arrival()), formulation="scaled"),
        "arrival weighs frames by their error bars",
    ),
    (lambda: Estimator((Arrival(),)), "arrival needs the term misfit"),
    (lambda: Estimator((Gradient(weight="auto"),)), "needs the term misfit"),
    (lambda: Estimator((Misfit(loss=Student(corner=4.0)),), "smoother"), SMOOTHER),
    (lambda: Estimator((NOISY,), "smoother"), SMOOTHER),
    (
        lambda: Estimator(
            (dataclasses.replace(NOISY, weight=2.0, loss=Huber(corner=3.0)),), "smoother"
        ),
        SMOOTHER,
    ),
    (
        lambda: Estimator(
            (dataclasses.replace(NOISY, loss=Student(corner=4.0)), Gradient()), "smoother"
        ),
        SMOOTHER,
    ),
]


@pytest.mark.parametrize(("make", "words"), IMPOSSIBLE, ids=range(len(IMPOSSIBLE)))
def test_impossible_configurations_give_one_sentence(
    make: Callable[[], object], words: str
) -> None:
    with pytest.raises(ValueError, match=words) as refusal:
        make()
    assert isinstance(refusal.value, InputError) or "\n" not in str(refusal.value)
