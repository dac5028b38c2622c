"""The solution of frames in a chain is that of its whole matrix."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array
from lampest.inference.evidence import swept
from lampest.posterior.chain import Chain
from lampest.posterior.linear import inverse_and_volume

SIZES = ((1, 3, 1), (2, 1, 2), (4, 3, 2), (6, 5, 3))  # frames, cells, unknowns of the border
every_size = pytest.mark.parametrize("size", SIZES)
ROUNDING = 1e-10  # relative; matrices of condition below 1e4


def chain_of(size: tuple[int, int, int]) -> tuple[Chain, Array]:
    """A chain of a positive definite matrix, and that matrix."""
    frames, cells, border = size
    rng = np.random.default_rng(size)
    root = rng.standard_normal((frames, cells, 2 * cells))
    tie = rng.uniform(0, 2, (frames - 1, cells))
    own = root @ root.swapaxes(1, 2) + (6 + border) * np.eye(cells)
    chain = Chain(
        own, tie, rng.standard_normal((frames, cells, border)), 9 * frames * cells * np.eye(border)
    )
    total = frames * cells
    matrix = np.zeros((total + border, total + border))
    for frame in range(frames):
        at = slice(frame * cells, (frame + 1) * cells)
        matrix[at, at] = own[frame]
        matrix[at, total:] = chain.border[frame]
        matrix[total:, at] = chain.border[frame].T
        if frame + 1 < frames:
            after = slice((frame + 1) * cells, (frame + 2) * cells)
            matrix[at, after] = matrix[after, at] = -np.diag(tie[frame])
    matrix[total:, total:] = chain.corner
    return chain, matrix


@every_size
def test_a_chain_is_solved_like_its_matrix(size: tuple[int, int, int]) -> None:
    frames, cells, border = size
    chain, matrix = chain_of(size)
    right = np.random.default_rng(1).standard_normal((len(matrix), 3))
    expected = np.linalg.solve(matrix, right)
    solved, moved = chain.solve(right[: frames * cells].reshape(frames, cells, 3), right[-border:])
    assert_allclose(np.concatenate([solved.reshape(-1, 3), moved]), expected, rtol=ROUNDING)


@every_size
def test_the_covariances_of_a_chain_are_those_of_its_inverse(size: tuple[int, int, int]) -> None:
    """Own, shared, successive and later blocks, and the variances of steps."""
    frames, cells, border = size
    chain, matrix = chain_of(size)
    inverse = np.linalg.inv(matrix)
    total = frames * cells
    between = inverse[:total, :total].reshape(frames, cells, frames, cells)
    assert_allclose(chain.border_covariance, inverse[total:, total:], rtol=ROUNDING)
    for frame in range(frames):
        covariance = between[frame, :, frame]
        assert_allclose(chain.covariance(frame), covariance, rtol=ROUNDING, atol=ROUNDING)
        assert_allclose(chain.variance[frame], np.diag(covariance), rtol=ROUNDING)
        known_border = np.linalg.inv(matrix[:total, :total]).reshape(between.shape)
        assert_allclose(
            chain.shared_variance(frame),
            np.diag(covariance - known_border[frame, :, frame]),
            rtol=ROUNDING / min(1, np.min(chain.shared_variance(frame))),
        )
        later = [np.diag(between[frame, :, number]) for number in range(frame, frames)]
        assert_allclose(chain.since(frame), later, rtol=ROUNDING, atol=ROUNDING)
    shift = np.random.default_rng(2).standard_normal((frames - 1, border))
    for frame in range(frames - 1):
        step = np.zeros((cells, len(matrix)))
        step[:, (frame + 1) * cells : (frame + 2) * cells] = np.eye(cells)
        step[:, frame * cells : (frame + 1) * cells] -= np.eye(cells)
        step[:, total:] = -shift[frame]
        assert_allclose(
            chain.step_variance(shift)[frame], np.diag(step @ inverse @ step.T), rtol=ROUNDING
        )


@every_size
def test_a_doubted_border_has_its_prior_and_a_share_of_the_information(
    size: tuple[int, int, int],
) -> None:
    """Precision of the border: prior + share · (information of the frames)."""
    border = size[-1]
    chain, _ = chain_of(size)
    prior = np.random.default_rng(3).uniform(1, 2, border)
    precision = np.linalg.inv(chain.border_covariance)
    for share in (0.0, 0.3, 1.0):
        assert_allclose(
            np.linalg.inv(chain.doubting(share, prior).border_covariance),
            (1 - share) * np.diag(prior) + share * precision,
            rtol=ROUNDING,
            atol=ROUNDING * np.max(np.abs(precision)),
        )
    assert_allclose(
        chain.learned(border), precision - np.eye(border), atol=ROUNDING * np.max(np.abs(precision))
    )
    for count in range(1, border + 1):
        root = np.random.default_rng(count).standard_normal((count, 2 * count))
        given = root @ root.T + np.eye(count)
        after = chain.with_border(given).border_covariance[:count, :count]
        assert_allclose(np.linalg.inv(after), given, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize("count", [1, 2, 5, 9])
def test_sweeps_solve_a_system_in_any_order_and_give_its_determinant(count: int) -> None:
    """Swept by all places, (A, b) is (−A⁻¹, A⁻¹ b); the pivots multiply to the determinant."""
    rng = np.random.default_rng(count)
    root = rng.standard_normal((count, 2 * count))
    matrix = root @ root.T + np.eye(count)
    right = rng.standard_normal((count, 1))
    inverse, volume = inverse_and_volume(matrix)
    assert_allclose(inverse @ matrix, np.eye(count), atol=ROUNDING)
    for order in (np.arange(count), rng.permutation(count)):
        table = np.hstack([matrix, right])
        pivots = []
        for place in order:
            pivots.append(table[place, place])
            table = swept(table, place)
        assert_allclose(table, np.hstack([-inverse, inverse @ right]), rtol=1e-8, atol=ROUNDING)
        assert volume == pytest.approx(-np.sum(np.log(pivots)), rel=ROUNDING, abs=ROUNDING)
