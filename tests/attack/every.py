"""All attacks. A new one joins the tuple of its module; a new module joins here."""

from attack import damage, libraries, lines, memory, names, values, writes
from attack.attack import Attack

ATTACKS: tuple[Attack, ...] = (
    *writes.ATTACKS,
    *damage.ATTACKS,
    *memory.ATTACKS,
    *names.ATTACKS,
    *values.ATTACKS,
    *lines.ATTACKS,
    *libraries.ATTACKS,
)
