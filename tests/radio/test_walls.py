import numpy as np
import pytest

from linkrover.errors import ConfigError
from linkrover.radio.walls import FloorPlan, Wall

PLAN = FloorPlan((Wall(5, 0, 5, 10, 6.0), Wall(5, 10, 15, 10, 3.0)), 0, 0, 20, 20)


def test_a_path_loses_what_each_wall_it_crosses_costs():
    assert PLAN.crossed(1, 5, 9, 5) == (1, 6.0)
    assert PLAN.crossed(4, 5, 12, 12)[0] == 2
    assert PLAN.crossed(1, 5, 4, 9) == (0, 0.0)
    assert PLAN.crossed(1, 15, 18, 15) == (0, 0.0)


def test_a_path_through_the_joint_of_two_walls_crosses_one_of_them():
    joined = FloorPlan((Wall(5, 0, 5, 10), Wall(5, 10, 5, 20)))
    assert joined.crossed(0, 10, 10, 10)[0] == 1


def test_arrays_give_what_single_paths_give():
    rng = np.random.default_rng(3)
    ends = rng.uniform(0, 20, (200, 4))
    many = PLAN.loss_db(*ends.T)
    assert many == pytest.approx([PLAN.crossed(*path)[1] for path in ends])


def test_bad_plans_are_named():
    with pytest.raises(ConfigError, match=r"walls\[1\].*outside the plan.*x 0 to 20"):
        FloorPlan((Wall(1, 1, 2, 2), Wall(1, 1, 30, 2)), 0, 0, 20, 20)
    with pytest.raises(ConfigError, match="loss_db"):
        Wall(0, 0, 1, 1, -3.0)
    with pytest.raises(ConfigError, match="two different ends"):
        Wall(1, 1, 1, 1)
    with pytest.raises(ConfigError, match="x_max_m"):
        FloorPlan((), 5, 0, 5, 1)
