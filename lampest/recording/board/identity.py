"""The scene that a board's HELLO and a user's scene agree on."""

from dataclasses import replace

from lampest.files.errors import InputError
from lampest.panel.panel import Panel
from lampest.panel.readouts import LoadedColumnsReadout, Readout, TwoPointReadout
from lampest.panel.readouts.lines import as_tuple
from lampest.panel.scene import Scene
from lampest.recording.board.protocol import Hello

# What a board and a scene must say alike, by the board's wiring.
SHARED = {
    "two_point": ("supply_volt", "reference_ohm", "measured_across", "adc_bits"),
    "loaded_columns": ("driven", "polarity", "supply_volt", "adc_bits"),
}
# A calibrated load differs from the one that is printed on it: 5 % of ordinary resistors, twice.
LOAD_TOLERANCE = 0.1


def scene_of(hello: Hello, scene: Scene | None) -> Scene:
    """The scene that the board's HELLO and the user's scene agree on; without a scene, what the board says.

    Raises InputError where they contradict each other.
    """
    told = told_readout(hello)
    if scene is None:
        return Scene(Panel(hello.rows, hello.columns), told)
    if scene.readout is None:
        return replace(scene, readout=told)
    if scene.readout.kind != hello.wiring:
        raise InputError(
            f"the scene's readout.kind is {scene.readout.kind}, but the board says that it is wired as {hello.wiring} "
            f"(firmware pins.h)"
        )
    for name in SHARED[hello.wiring]:
        ours, theirs = getattr(scene.readout, name), getattr(told, name)
        if ours != theirs:
            raise InputError(f"the scene's readout.{name} is {ours}, but the board says {theirs} (firmware pins.h)")
    _check_loads(scene.readout, told)
    panel = scene.panel
    most = (hello.most_rows, hello.most_columns, hello.most_readings)
    asked = (panel.rows, panel.columns, scene.readout.readings)
    for name, ours, theirs in zip(("panel.rows", "panel.columns", "readout.readings"), asked, most, strict=True):
        if ours > theirs:
            raise InputError(f"the scene's {name} is {ours}, but the board can do at most {theirs}")
    return scene


def told_readout(hello: Hello) -> TwoPointReadout | LoadedColumnsReadout:
    """The circuit and the converter as the board declares them."""
    supply, reference = hello.supply_millivolt / 1000, hello.reference_milliohm / 1000
    if hello.wiring == "loaded_columns":
        return LoadedColumnsReadout(
            supply_volt=supply,
            load_ohm=reference,
            drive_ohm=hello.drive_milliohm / 1000,
            adc_bits=hello.adc_bits,
            readings=hello.readings,
        )
    return TwoPointReadout(
        supply_volt=supply,
        reference_ohm=reference,
        measured_across=hello.measured_across,
        adc_bits=hello.adc_bits,
        readings=hello.readings,
    )


def _check_loads(ours: Readout, told: Readout) -> None:
    """Raise InputError where a load is not what the board says, give or take what resistors differ by."""
    if not (isinstance(ours, LoadedColumnsReadout) and isinstance(told, LoadedColumnsReadout)):
        return
    (nominal,) = as_tuple(told.load_ohm)
    for load in as_tuple(ours.load_ohm):
        if abs(load / nominal - 1) > LOAD_TOLERANCE:
            raise InputError(
                f"the scene's readout.load_ohm is {load:g}, but the board says {nominal:g} (firmware pins.h)"
            )
