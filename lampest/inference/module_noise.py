"""Noise of a panel of modules from that of each module, and sentences that name modules."""

from collections.abc import Mapping, Sequence

import numpy as np

from lampest.inference.noise import NoiseEstimate
from lampest.panel.panel import Modules
from lampest.recording.readings import Readings
from lampest.recording.recording import Recording

MAX_NAMED = 3  # modules in one sentence


def noise_of_modules(
    recording: Recording, layout: Modules, every: Sequence[NoiseEstimate | None]
) -> NoiseEstimate:
    """Return the noise of a panel of modules from the noise of each module.

    None stands for a dead one.
    """
    recorded = recording.readings()
    readings = [
        recorded.of_module(layout, n) if noise is None else noise.readings
        for n, noise in enumerate(every)
    ]
    no_outliers = np.zeros(recording.modules[0].recorded.shape, dtype=bool)
    outliers = np.stack(
        [no_outliers if noise is None else noise.outliers for noise in every], axis=-3
    )
    messages = [
        f"module {list(layout.place(n))}: {noise.sentence}"
        for n, noise in enumerate(every)
        if noise is not None and noise.warnings
    ]
    more = f"and {len(messages) - MAX_NAMED} modules more" if len(messages) > MAX_NAMED else ""
    joined = Readings.of_parts(layout, readings)
    estimated = dict[str, tuple[float, float]]()
    for n, noise in enumerate(every):
        if noise is not None:
            place = list(layout.place(n))
            estimated |= {f"{key} of module {place}": size for key, size in noise.estimated.items()}
    image = NoiseEstimate(
        layout.joined(outliers), (), joined, of_modules=tuple(every), estimated=estimated
    )
    return image.with_warnings(*messages[:MAX_NAMED], more)


def named_modules(
    layout: Modules, texts: Mapping[int, str], most: int | None = None
) -> tuple[str, ...]:
    """Return sentences on modules, one for each text: 'modules [0, 1], [0, 2] and 3 more: dead'.

    Parameters
    ----------
    layout : Modules
    texts : mapping
        Number of a module to its text.
    most : int, optional
        Largest number of named modules in a sentence.
    """
    sentences = []
    for text in dict.fromkeys(texts.values()):
        names = [str(list(layout.place(number))) for number in texts if texts[number] == text]
        more = f" and {len(names) - most} more" if most and len(names) > most else ""
        sentences.append(
            f"module{'s' if len(names) > 1 else ''} {', '.join(names[:most])}{more}: {text}"
        )
    return tuple(sentences)
