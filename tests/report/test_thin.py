from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.report.thin import thin, thin_points

values = st.lists(st.one_of(st.just(float("nan")), st.floats(-100, 100)), min_size=0, max_size=500)


@given(values, st.integers(3, 60))
@settings(max_examples=60, deadline=None)
def test_thinning_a_line_keeps_its_extremes_its_order_and_its_gaps(numbers, most):
    value = np.array(numbers, dtype=float)
    t_s = np.arange(len(value), dtype=float)
    kept_t, kept = thin(t_s, value, most)
    assert len(kept) <= max(most, 3 * max(1, most // 3))
    assert (np.diff(kept_t) > 0).all()
    if np.isfinite(value).any():
        assert np.nanmax(kept) == np.nanmax(value)
        assert np.nanmin(kept) == np.nanmin(value)
    assert np.isnan(kept).any() == np.isnan(value).any()


@given(values, st.integers(20, 60))
@settings(max_examples=60, deadline=None)
def test_thinning_a_cloud_keeps_its_highest_point_and_only_true_points(numbers, most):
    value = np.array(numbers, dtype=float)
    kept_t, kept = thin_points(np.arange(len(value), dtype=float), value, most)
    assert np.isfinite(kept).all()
    assert (value[kept_t.astype(int)] == kept).all()
    if np.isfinite(value).any():
        assert kept.max() == np.nanmax(value)


def test_arrays_of_different_length_are_refused():
    with pytest.raises(ValueError, match="t_s has 2 values and value has 3"):
        thin(np.zeros(2), np.zeros(3))
