"""Contacts of a map of changes: their number and their cells."""

import numpy as np
import pytest
from promises import promise

from docs.studies.contacts import MAT, trial
from lampest import Panel
from lampest.apps.recognition.suction import contacts_of

PANEL = Panel(12, 14, 20.0)
SD = np.full(PANEL.shape, 0.02)


def blob(x: float, y: float, width: float, depth: float) -> np.ndarray:
    """ln r/r0 under a soft load about column x and row y, in cells."""
    rows, columns = np.indices(PANEL.shape)
    return -depth * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * width**2))


def test_two_loads_under_one_cover_are_two_contacts() -> None:
    change = blob(3.5, 6, 1.2, 3.0) + blob(9.5, 6, 1.2, 2.0)
    left, right = contacts_of(PANEL, change, SD)
    assert left[6, 3] and right[6, 9] and not (left & right).any()
    assert np.all(change[6, 3:10] < -0.1), "cells between them have changed clearly"
    assert not (left | right)[:, 6:8].all()


def test_errors_of_the_cells_divide_no_contact() -> None:
    change = blob(5, 5, 3.0, 3.0)
    change[:, 5] *= 0.25  # of the cells beside it, by an error of two standard deviations
    assert len(contacts_of(PANEL, change, SD)) == 2
    (contact,) = contacts_of(PANEL, change, np.where(np.arange(14) == 5, 0.22, SD))
    assert contact[5, 5]


def test_an_unread_line_divides_no_contact() -> None:
    change = blob(5, 5, 2.0, 3.0)
    change[:, 5] = 0.0
    assert len(contacts_of(PANEL, change, SD)) == 2
    (contact,) = contacts_of(PANEL, change, np.where(np.arange(14) == 5, 1.0, SD))
    assert contact[5, 4] and contact[5, 6] and not contact[:, 5].any()


def test_heel_and_ball_of_a_foot_are_one_contact() -> None:
    change = blob(5, 2.5, 1.3, 3.2) + blob(5, 9, 1.5, 2.8) + blob(5, 6, 1.2, 1.2)
    (foot,) = contacts_of(PANEL, change, SD)
    assert foot[2, 5] and foot[6, 5] and foot[9, 5]


@promise("apps/recognition/detect: Cells that conduct less than at rest are never a contact.")
def test_cells_of_lower_conductance_are_not_a_contact() -> None:
    change = blob(5, 5, 1.5, 2.0) - blob(11, 9, 0.7, 1.0)
    (contact,) = contacts_of(PANEL, change, SD)
    assert contact[5, 5] and not contact[9, 11]
    assert contacts_of(PANEL, -blob(5, 5, 1.5, 2.0), SD) == []


def test_a_change_within_the_noise_is_not_a_contact() -> None:
    change = blob(5, 5, 1.5, 3.0)
    change[0, 13] = -0.1  # a thirtieth of the load's: an error of the circuit
    change[11, 0] = -0.5
    unsure = SD.copy()
    unsure[11, 0] = 0.3
    assert len(contacts_of(PANEL, change, unsure)) == 1
    assert len(contacts_of(PANEL, change, SD)) == 2


def test_a_faint_pair_of_cells_near_a_heavy_load_is_not_a_contact() -> None:
    change = blob(4, 6, 1.5, 2.0)
    change[6, 12:14] = -0.22  # as in the rows of two feet, where nothing stood
    assert len(contacts_of(PANEL, change, SD)) == 1
    change[5:8, 12:14] = -0.22
    assert len(contacts_of(PANEL, change, SD)) == 2


def test_a_light_load_near_a_heavy_one_is_a_contact() -> None:
    heavy, light = contacts_of(PANEL, blob(3, 6, 1.2, 3.5) + blob(10, 6, 1.0, 0.5), SD)
    assert heavy[6, 3] and light[6, 10]


def test_one_unloaded_cell_between_two_loads_makes_them_two_contacts() -> None:
    change = np.zeros(PANEL.shape)
    change[3:6, 3:6] = change[3:6, 7:10] = -1.0
    assert len(contacts_of(PANEL, change, SD)) == 2
    change[3:6, 6] = -0.8
    assert len(contacts_of(PANEL, change, SD)) == 1


@pytest.mark.slow
def test_internal_pull_ups_of_unknown_size_hide_no_light_contact() -> None:
    """A rod of 51 g beside one of 222 g: the tolerance of 43 % of the pull-ups explained it."""
    light = trial(50, 11, MAT)
    assert light.circuit == "pull_ups" and len(light.rods) == 2
    assert light.right
