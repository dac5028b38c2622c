"""Disturbances: contacts of one thing that comes and goes, such as a waving plant."""

from collections.abc import Sequence
from dataclasses import replace

from lampest.apps.recognition.attachment import Attachment

# Assumed longest pause between two contacts of one disturbance, s: plants wave and bodies beat
# several times a minute, and a visit after a longer pause counts as another.
MAX_PAUSE_S = 20.0


def disturbances(attachments: Sequence[Attachment]) -> tuple[Attachment, ...]:
    """Return attachments in which each contact is joined to the last one in its place.

    The pause between both is at most MAX_PAUSE_S, and neither sucks. The joined contact has the
    figures of the clearest one, from the first arrival to the last departure.
    """
    joined = list[Attachment]()
    for load in sorted(attachments, key=lambda attachment: attachment.since_s):
        number = next(
            (number for number in range(len(joined)) if _returns(joined[number], load)), None
        )
        if number is None:
            joined.append(load)
        else:
            former = joined[number]
            clearest = max(former, load, key=lambda contact: contact.clear)
            joined[number] = replace(clearest, since_s=former.since_s, until_s=load.until_s)
    return tuple(joined)


def _returns(former: Attachment, load: Attachment) -> bool:
    """Return whether a contact is one of the same disturbance as a former one, which has left."""
    if former.until_s is None or former.sucks > 0.5 or load.sucks > 0.5:
        return False
    pause_s = load.since_s - former.until_s
    return 0 <= pause_s <= MAX_PAUSE_S and former.adjoins(load)
