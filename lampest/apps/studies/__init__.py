"""Studies of solvers and formulations: timings, trade-offs, numerical extremes."""

from lampest.files.applications import Application, Command

STUDIES = "lampest.apps.studies.commands"
APPLICATION = Application(
    name="studies",
    about="measurements of lampest itself",
    groups={"study": "Measure lampest itself: solvers, formulations, extremes."},
    commands={
        f"study {word}": Command(
            part="Study",
            target=f"{STUDIES}:{word}",
            example=f"{word}.yaml --out results/mine",
        )
        for word in ("bench", "tradeoff", "extremes")
    },
)
