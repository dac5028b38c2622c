"""What is read on panels of every size: mouths and rods on uneven cells, through the electronics that a file names."""

from lampest.loads.shapes import AnyShape, OralDisc, Rod
from lampest.recording.simulation.course import Course

BREATHING = Course(start_s=-0.8, approach_s=0.6, attachment_s=2, breathing_hz=1.15, breathing_depth=0.1)
GROWING = Course(start_s=-0.4, approach_s=2, attachment_s=2, breathing_hz=1.15, breathing_depth=0.1)
MOUTH_MM, RIM_MM = 35.0, 6.0  # of the shipped recording of a lamprey
PITCH_MM = 10.0
# Places as shares of the panel's width and height, and masses in g: rods of 40 mm press with 2 to 9 kPa.
RODS = ((0.3, 0.3, 680.0), (0.7, 0.35, 300.0), (0.4, 0.75, 1200.0))


def loads(number: int, shape: tuple[int, int]) -> tuple[tuple[AnyShape, ...], Course]:
    """What touches the panel in recording `number`, and when; recordings 0, 1, 2 differ, then they come again.

    0 : a mouth over a third of the shorter side, sucking ever harder, breathing. 1 : three rods that stand. 2 : a mouth
    of 35 mm that presses ever harder, then sucks, beside a rod.
    """
    height, width = (PITCH_MM * (side - 1) for side in shape)
    rods = tuple(
        Rod(kind="rod", centre_mm=(right * width, down * height), diameter_mm=40, mass_g=mass)
        for right, down, mass in RODS
    )
    mouths = (
        _mouth((0.49 * width, 0.51 * height), 0.35 * PITCH_MM * min(shape)),
        _mouth((0.6 * width, 0.55 * height), MOUTH_MM),
    )
    return (((mouths[0],), BREATHING), (rods, Course()), ((mouths[1], rods[0]), GROWING))[number % 3]


def _mouth(centre_mm: tuple[float, float], diameter_mm: float) -> OralDisc:
    """That of the shipped recording, of another size at another place."""
    return OralDisc(
        kind="oral_disc",
        centre_mm=centre_mm,
        diameter_mm=diameter_mm,
        rim_width_mm=diameter_mm * RIM_MM / MOUTH_MM,
        pressure_kpa=-12,
        rim_kpa=90,
        tilt=0.25,
        tilt_direction_deg=60,
    )
