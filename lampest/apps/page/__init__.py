"""Report page of a batch.

It has results of each estimator and recording, a recommendation, and its uncertainty.
"""

from lampest.files.applications import Application

APPLICATION = Application(
    name="page",
    about="a batch as one HTML file",
    answers={"report": "lampest.apps.page.page:write_report"},
)
