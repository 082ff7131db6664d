"""An exported policy equals torch's, needs NumPy alone, and a damaged file is told as such."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from kfenv.agents.contestants.policy import NumpyPolicy
from kfenv.agents.learning.reinforcement.export import export_policy

ABOUT = {"env_id": "Uneven-v0", "env_kwargs": {"rate": 2}, "note": "a test"}


class Uneven(gym.Env):
    """Only its spaces matter: an action space that is neither symmetric nor uniform."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (7,), np.float32)
    action_space = gym.spaces.Box(np.float32([-2, 0, -1]), np.float32([2, 5, 1]))

    def reset(self, *, seed=None, options=None):
        return np.zeros(7, np.float32), {}

    def step(self, action):
        return np.zeros(7, np.float32), 0.0, False, True, {}


def _model(algorithm, activation, **arguments):
    torch = pytest.importorskip("torch")
    sb3 = pytest.importorskip("stable_baselines3")
    kind = {"ppo": sb3.PPO, "sac": sb3.SAC}[algorithm]
    how = {"activation_fn": getattr(torch.nn, activation), "net_arch": [16, 12]}
    model = kind("MlpPolicy", Uneven(), seed=0, policy_kwargs=how, device="cpu", **arguments)
    with torch.no_grad():  # untrained means are near zero; spread them to reach the bounds
        for parameter in model.policy.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    return model


@pytest.fixture
def policy_file(tmp_path):
    return export_policy(_model("ppo", "Tanh"), tmp_path / "policy.npz", ABOUT)


@pytest.mark.parametrize("activation", ["Tanh", "ReLU"])
@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_exported_policy_equals_torch(algorithm, activation, tmp_path):
    model = _model(algorithm, activation)
    policy = NumpyPolicy.load(export_policy(model, tmp_path / "policy.npz", ABOUT))
    rng = np.random.default_rng(0)
    for scale in (0.1, 1.0, 10.0):
        observations = (scale * rng.standard_normal((500, 7))).astype(np.float32)
        wanted, _ = model.predict(observations, deterministic=True)
        got = policy.predict(observations)
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-5)
        assert got.dtype == np.float32
        np.testing.assert_allclose(policy.predict(observations[0]), got[0], rtol=0, atol=1e-6)
    assert np.ptp(wanted, axis=0).min() > 1.0  # the comparison saw varied actions


def test_exported_policy_says_what_it_is(policy_file):
    policy = NumpyPolicy.load(policy_file)
    assert (policy.network.algorithm, policy.network.activation) == ("ppo", "tanh")
    assert (policy.observation_size, policy.action_size) == (7, 3)
    assert (policy.env_id, policy.env_kwargs) == ("Uneven-v0", {"rate": 2})
    assert policy.metadata == {"note": "a test"}


def test_policy_needs_no_learning_library():
    code = "import sys, kfenv.agents.contestants.policy; print('torch' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"


def test_wrong_observations_are_told(policy_file):
    with pytest.raises(ValueError, match=r"observations of 7 numbers.*\(4, 5\).*Uneven-v0"):
        NumpyPolicy.load(policy_file).predict(np.zeros((4, 5)))


def test_failed_export_leaves_the_former_file(policy_file):
    before = policy_file.read_bytes()
    with pytest.raises(TypeError):
        export_policy(_model("ppo", "ReLU"), policy_file, {**ABOUT, "note": object()})
    assert policy_file.read_bytes() == before
    assert list(policy_file.parent.iterdir()) == [policy_file]


def test_models_without_a_plain_form_are_refused(tmp_path):
    with pytest.raises(ValueError, match="state-dependent exploration"):
        export_policy(_model("sac", "ReLU", use_sde=True), tmp_path / "policy.npz", ABOUT)
    with pytest.raises(ValueError, match="elu"):
        export_policy(_model("ppo", "ELU"), tmp_path / "policy.npz", ABOUT)
    assert not list(tmp_path.iterdir())


def _assert_refused(path):
    with pytest.raises(ValueError, match=r"is not a policy of kfenv or is damaged") as caught:
        NumpyPolicy.load(path)
    assert "\n" not in str(caught.value) and path.name in str(caught.value)


def test_missing_file_is_told(tmp_path):
    with pytest.raises(FileNotFoundError, match="no policy file"):
        NumpyPolicy.load(tmp_path / "policy.npz")


def test_truncated_or_altered_file_is_refused(policy_file):
    whole = policy_file.read_bytes()
    for length in (0, 1, 3, 10, 500, len(whole) // 2, len(whole) - 1):
        policy_file.write_bytes(whole[:length])
        _assert_refused(policy_file)
    altered = bytearray(whole)
    altered[whole.index(b"weight_0") + 300] ^= 0xFF
    policy_file.write_bytes(altered)
    _assert_refused(policy_file)


def test_foreign_files_are_refused(tmp_path):
    path = tmp_path / "policy.npz"
    path.write_text("no policy at all")
    _assert_refused(path)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    _assert_refused(path)
    np.savez(path, a=np.zeros(3))
    _assert_refused(path)
    np.savez(path, format=np.array({"a": 1}, dtype=object))
    _assert_refused(path)
    _assert_refused(tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"format": "kfenv-policy-99"},
        {"algorithm": "dqn"},
        {"activation": "elu"},
        {"layers": 2},
        {"layers": 0},
        {"bias_1": np.zeros(3)},
        {"weight_0": np.full((7, 16), np.nan)},
        {"low": np.zeros(4)},
        {"low": np.full(3, np.nan)},
        {"low": np.float32([2, 5, 1])},
        {"layers": np.inf},
        {"layers": 1e12},
        {"about": "{"},
        {"about": "[" * 100_000},
    ],
)
def test_inconsistent_contents_are_refused(policy_file, change):
    with np.load(policy_file) as file:
        arrays = dict(file)
    np.savez(policy_file, **arrays | change)
    _assert_refused(policy_file)
