"""Report page of a batch: results of each estimator and recording, and a recommendation."""

from lampest.files.applications import Application

APPLICATION = Application(
    name="page",
    about="a batch as one HTML file",
    answers={"report": "lampest.apps.page.page:write_report"},
)
