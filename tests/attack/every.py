"""All attacks. A new one joins the tuple of its module; a new module joins here."""

from attack import boards, damage, inputs, libraries, memory, names, types, values, writes
from attack.attack import Attack

ATTACKS: tuple[Attack, ...] = (
    *writes.ATTACKS,
    *damage.ATTACKS,
    *inputs.ATTACKS,
    *memory.ATTACKS,
    *names.ATTACKS,
    *values.ATTACKS,
    *types.ATTACKS,
    *boards.ATTACKS,
    *libraries.ATTACKS,
)
