"""The environment of the camera follower's task: what it refuses, what it shows, and that a seed is a run."""

import sys
from pathlib import Path

import gymnasium
import numpy as np
import pages
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv
from ran import ran

from deltaq_cell.cell_model import CellModel
from deltaq_experiments.scene import camera_controller, scene_of
from deltaq_experiments.training import ENVIRONMENT
from deltaq_experiments.training.environment import CameraEnvironment, CameraTask, ViewErrors
from deltaq_protocol.errors import DeltaqError

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "train-a-policy.md"


@pytest.fixture(scope="module")
def env() -> CameraEnvironment:
    return CameraEnvironment(duration_s=0.12)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"cell": "dawm"}, "no robot of cell dawm carries a camera"),
        ({"duration_s": 0.0}, "duration_s must be a finite time above 0 s, got 0.0"),
        ({"duration_s": float("nan")}, "duration_s must be a finite time above 0 s, got nan"),
        ({"start_error_deg": 181.0}, "start_error_deg must be above 0 and at most 150, got 181.0"),
        ({"leader_speed_m_s": -1.0}, "speed_m_s must be a finite number of m/s, 0 or more, got -1.0"),
        ({"latency_s": -0.1}, "latency_s must be a finite time of at least 0 s, got -0.1"),
    ],
)
def test_impossible_arguments_are_refused_when_the_environment_is_made(arguments: dict, said: str) -> None:
    with pytest.raises(DeltaqError, match=f"^{said}"):
        CameraEnvironment(**arguments)


def test_a_step_before_the_first_reset_is_refused() -> None:
    with pytest.raises(DeltaqError, match=r"no episode is running: call reset\(\) first"):
        CameraEnvironment().step(np.zeros(6))


@pytest.mark.parametrize("action", [np.zeros(5), np.zeros((6, 1)), np.full(6, np.nan), np.full(6, np.inf)])
def test_an_invalid_action_is_refused_and_the_episode_continues(
    env: CameraEnvironment, action: np.ndarray
) -> None:
    env.reset(seed=0)
    with pytest.raises(DeltaqError, match=r"action: \(6,\) finite numbers are expected"):
        env.step(action)
    assert env.step(np.zeros(6))[4]["verdict"]["outcome"] == "admitted"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"begin": 0}, "options: begin is not an option; only start is"),
        ({"start": np.zeros(5)}, "options: start must be 6 angles between"),
        ({"start": np.full(6, 100.0)}, "options: start must be 6 angles between"),
        ({"start": np.full(6, np.nan)}, "options: start must be 6 angles between"),
    ],
)
def test_a_reset_names_the_wrong_option(env: CameraEnvironment, options: dict, said: str) -> None:
    with pytest.raises(DeltaqError, match=said):
        env.reset(options=options)


@pytest.mark.nightly
def test_the_checker_of_gymnasium_finds_nothing() -> None:
    made = gymnasium.make(f"deltaq_experiments.training:{ENVIRONMENT}", duration_s=0.12)
    check_env(made.unwrapped, skip_render_check=True)


@pytest.mark.long
def test_a_seed_determines_the_run_bit_for_bit(env: CameraEnvironment) -> None:
    def run(seed: int) -> list[np.ndarray]:
        first, _ = env.reset(seed=seed)
        env.action_space.seed(seed)
        seen = [env.step(env.action_space.sample())[0] for _ in range(10)]
        return [
            part[name] for view in (first, *seen) for part in view.values() for name in ("q", "q_cmd", "dq")
        ]

    once, again, other = run(4), run(4), run(5)
    assert all(np.array_equal(*pair) for pair in zip(once, again, strict=True))
    assert not np.array_equal(once[-3], other[-3])
    assert not np.array_equal(once[0], other[0])


def test_an_episode_has_its_given_length_and_a_verdict_for_every_increment(env: CameraEnvironment) -> None:
    env.reset(seed=0)
    steps = [env.step(np.full(6, 0.1)) for _ in range(10)]
    assert [truncated for *_, truncated, _ in steps] == [False] * 9 + [True]
    assert not any(terminated for _, _, terminated, _, _ in steps)
    for _, _, _, _, info in steps:
        assert info["verdict"]["outcome"] == "admitted"
        np.testing.assert_array_equal(info["verdict"]["dq"], info["dq"])


@pytest.mark.long
def test_the_reward_agrees_with_the_view_errors_of_the_experiments(env: CameraEnvironment) -> None:
    env.reset(seed=1)
    camera = camera_controller(scene_of(CellModel.load("lab")))
    for _ in range(3):
        observation, reward, *_, info = env.step(np.full(6, 0.05))
        q = {name: np.array(env.episode.stack.states[name].q) for name in ("fr", "gr")}
        angle, distance = camera.errors(q["fr"], q["gr"])
        np.testing.assert_array_equal(observation["own"]["q"], q["fr"])
        assert (info["angle_rad"], info["distance_m"]) == pytest.approx((angle, distance))
        assert reward == pytest.approx(-angle - abs(distance))
    assert ViewErrors(0.0, -0.5).reward == -0.5


@pytest.mark.long
def test_a_start_is_the_given_one_or_within_the_given_error(env: CameraEnvironment) -> None:
    home = CellModel.load("lab").robots["fr"].home
    observation, _ = env.reset(seed=0, options={"start": home})
    np.testing.assert_allclose(observation["own"]["q"], home, atol=1e-5)
    task = CameraTask(scene_of(CellModel.load("lab")))
    for seed in range(3):
        observation, info = env.reset(seed=seed)
        assert np.pi / 6 - 0.01 < info["angle_rad"] < np.pi / 3 + 0.01
        assert task.errors(observation["own"]["q"], observation["leader"]["q"]).angle_rad == pytest.approx(
            info["angle_rad"], abs=1e-3
        )


@pytest.mark.long
def test_a_refusing_verdict_has_its_reason() -> None:
    env = CameraEnvironment(duration_s=60.0, start_error_deg=10.0)
    env.reset(seed=0)
    down = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])  # A2 forward, towards the floor
    reasons: set[str] = set()
    for _ in range(300):
        *_, info = env.step(down)
        reasons |= {reason["code"] for reason in info["verdict"].get("reasons", ())}
        if "clearance" in reasons:
            break
    assert "clearance" in reasons
    assert info["verdict"]["outcome"] in ("scaled", "held")


@pytest.mark.long
@pytest.mark.nightly
def test_a_vector_of_environments_has_the_verdicts_of_each() -> None:
    envs = SyncVectorEnv([lambda: CameraEnvironment(duration_s=0.05)] * 2)
    envs.reset(seed=7)
    for _ in range(8):  # into the second episode of each
        observation, reward, *_, info = envs.step(np.zeros((2, 6)))
    assert observation["own"]["q"].shape == (2, 6)
    assert not np.array_equal(*observation["own"]["q"])
    assert reward.shape == (2,)
    assert list(info["verdict"]["outcome"]) == ["admitted", "admitted"]
    envs.close()


@pytest.mark.nightly
def test_the_scripts_of_the_page_run_as_they_are_printed(tmp_path: Path) -> None:
    scripts = [step for step in pages.steps(PAGE.read_text(encoding="utf-8")) if step.argument == "python"]
    assert scripts
    for script in scripts:
        done = ran([sys.executable, "-"], input=script.text, cwd=tmp_path, check=False)
        assert done.returncode == 0, f"line {script.line}: {done.stderr}"
        assert done.stdout
