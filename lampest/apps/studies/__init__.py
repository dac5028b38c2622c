"""Studies of solvers and estimators: timings, trade-offs, extremes, weights, the paper."""

from lampest.files.applications import Application, Command

STUDIES = "lampest.apps.studies.commands"
APPLICATION = Application(
    name="studies",
    about="measurements of lampest itself",
    needs=("page",),
    groups={
        "study": "Measure lampest itself: solvers, formulations, extremes, weights, the paper."
    },
    commands={
        f"study {word}": Command(
            part="Study",
            target=f"{STUDIES}:{word}",
            example="--out results/paper" if word == "paper" else f"{word}.yaml --out results/mine",
            renamed=("tune" if word == "weights" else word,),
        )
        for word in ("bench", "tradeoff", "extremes", "weights", "paper")
    },
)
