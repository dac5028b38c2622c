"""Numbers of a circuit that no frame shows."""

from lampest.panel.effects import REFERENCE, SERIES, systematic_of
from lampest.panel.readouts.tolerances import line_numbers
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic


def unobservable_numbers(scene: Scene, of_changes: float | None = None) -> str:
    """Return a sentence on the numbers of a circuit that frames cannot determine.

    The sentence states the numbers with their assumed tolerances, in ASCII. It is '' for a scene
    without a readout, and for a readout that states no such numbers.

    Parameters
    ----------
    scene : Scene
    of_changes : float or None
        Median error of the changes ln(r/r0) of loaded cells by numbers at the ends of their
        tolerances; None where it is unknown.
    """
    if scene.readout is None:
        return ""
    sizes = systematic_of(scene) or Systematic()
    reference = sizes.size(REFERENCE)
    series = sizes.size(SERIES)
    within = (
        f"within {100 * reference:.3g} %" if reference else "exact",
        f"within {series:.3g} ohm" if series else "exact",
    )
    tolerances = {number.name: within[number.channel] for number in line_numbers(scene.circuit)}
    further = {"reference_ohm": within[0], "drive_volt": "exact", "converter_volt": "exact"}
    tolerances |= {name: size for name, size in further.items() if hasattr(scene.readout, name)}
    if not tolerances:
        return ""
    named = ", ".join(f"{name} ({size})" for name, size in tolerances.items())
    remaining = ""
    if of_changes is not None:
        remaining = (
            "; at these ends changes of loaded cells "
            f"are off by {100 * of_changes:.2g} % in the median"
        )
    return (
        f"no frame shows the numbers with which all cells scale, assumed {named}{remaining}; "
        "lampest calibrate measures them"
    )
