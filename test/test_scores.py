from __future__ import annotations

import numpy as np
import pytest

from smallwheel_ros.compare.scores import difference_std, levels, parts, score, varied
from smallwheel_ros.measurements.table import Measurements
from smallwheel_ros.physics.conditions import Conditions


def test_rmse_and_bias_of_known_residuals() -> None:
    found = score(np.array([3.0, -1.0, np.nan, 1.0]), np.array([0, 0, 1, 2]))
    assert found is not None
    assert (found.rows, found.runs) == (3, 2)
    assert found.rmse == pytest.approx(np.sqrt(11 / 3))
    assert found.bias == pytest.approx(1.0)
    assert found.rmse_std is None  # two runs say nothing of the spread between runs


def test_nothing_to_score_is_none() -> None:
    assert score(np.full(3, np.nan), np.arange(3)) is None


def test_standard_error_is_that_of_repeated_experiments() -> None:
    """Rows of a run share their error, so it is the number of runs that counts."""
    rng = np.random.default_rng(5)
    run = np.repeat(np.arange(40), 5)

    def residual() -> np.ndarray:
        return rng.normal(0, 1.0, 40)[run] + rng.normal(0, 0.2, run.size)

    rmse = [np.sqrt(np.mean(residual() ** 2)) for _ in range(400)]
    claimed = [score(residual(), run).rmse_std for _ in range(40)]  # type: ignore[union-attr]
    assert np.median(claimed) == pytest.approx(np.std(rmse), rel=0.2)


def test_models_with_the_same_errors_differ_by_nothing() -> None:
    rng = np.random.default_rng(6)
    run, noise = np.repeat(np.arange(30), 3), rng.normal(0, 1.0, 90)
    assert difference_std(noise, noise, run) == 0.0
    # paired: a common error cancels, so the difference is far better known than each error
    apart = difference_std(noise + 0.01, noise, run)
    alone = score(noise, run)
    assert apart is not None
    assert alone is not None
    assert alone.rmse_std is not None
    assert apart < 0.1 * alone.rmse_std
    assert difference_std(noise, noise, np.zeros(90, dtype=int)) is None


@pytest.mark.parametrize(
    ("values", "answer"),
    [
        (np.full(5, 0.1), False),
        (np.array([0.00998, 0.01001]), False),
        (np.array([0.01, 0.02]), True),
        (np.array([-1.0, 1.0]), True),
        (np.zeros(4), False),
        (np.full(4, np.nan), False),
    ],
)
def test_what_is_meant_to_be_constant_does_not_vary(values: np.ndarray, answer: bool) -> None:
    assert varied(values) is answer


def test_few_values_are_levels_and_many_are_not() -> None:
    got = levels(np.array([0.1, 0.1001, 0.2, 0.3, 0.3001]))
    assert got is not None
    assert got.tolist() == pytest.approx([0.10005, 0.2, 0.30005])
    assert levels(np.linspace(0, 1, 50)) is None


def test_parts_cover_each_row_once_by_each_column() -> None:
    rng = np.random.default_rng(7)
    rows = 60
    data = Measurements(
        Conditions.of(
            rng.uniform(20, 100, rows),
            np.repeat([0.1, 0.2, 0.3], 20),
            0.1,
            soil=np.where(np.arange(rows) % 2 == 0, "sand", "loam"),
            slip=np.full(rows, 0.2),
            moisture=np.where(np.arange(rows) < 5, np.nan, rng.uniform(0, 1, rows)),
        ),
        {"sinkage": rng.uniform(0, 0.01, rows)},
        np.arange(rows).astype(np.str_),
        np.full(rows, "wheel"),
        np.arange(rows),
    )
    found = parts(data)
    assert {part.by for part in found} == {"soil", "wheel", "load", "diameter", "moisture"}
    for by in ("soil", "wheel", "load", "diameter"):
        times = np.sum([part.rows for part in found if part.by == by], axis=0)
        assert (times == 1).all()
    moist = np.sum([part.rows for part in found if part.by == "moisture"], axis=0)
    np.testing.assert_array_equal(moist == 1, np.isfinite(data.conditions["moisture"]))
    for part in found:
        if part.range:
            inside = data.conditions[part.by][part.rows]
            assert inside.min() >= min(part.range) - 1e-12
            assert inside.max() <= max(part.range) + 1e-12
