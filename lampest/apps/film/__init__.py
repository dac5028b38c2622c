"""Films that remember, the zero of their pressures, and pressures with intervals."""

from lampest.files.applications import Application

APPLICATION = Application(
    name="film",
    about="pressures of loads, what a film remembers of them, and their zero",
    columns=tuple(
        f"lampest.apps.film.columns:{name}"
        for name in (
            "PRESSURE",
            "ERRORS",
            "OWN",
            "COMMON",
            "LOWER",
            "UPPER",
            "SATURATED",
            "PRESSING",
            "TARED",
        )
    ),
    scene_keys={"film": "lampest.panel.response:Film"},
    answers={
        "pressures": "lampest.apps.film.pressure:pressure_of",
        "memory of a film": "lampest.apps.film.memory:FilmKnown.specified",
        "a film at rest": "lampest.apps.film.memory:FilmMemory.at_rest",
    },
)
