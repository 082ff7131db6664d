"""A policy elsewhere, as ONNX or C, decides as it does here, and its contract names everything."""

import ctypes
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from kfenv.agents.cli.app import app
from kfenv.agents.contestants.policy import NumpyPolicy, write_policy
from kfenv.agents.deployment import TunedFilter
from kfenv.agents.deployment.contract import contract, page
from kfenv.agents.deployment.deployable import Deployable
from kfenv.agents.deployment.export import export_policy
from kfenv.agents.deployment.golden import golden
from policies import about, random_arrays, trained_on
from rollouts import BISTATIC, GNSS, INERTIAL, OWN, TRACKING, VALIDATION, short
from typer.testing import CliRunner

COMPILER = shutil.which("gcc") or shutil.which("cc")
WARNINGS = [
    "-std=c99",
    "-O1",
    "-Wall",
    "-Wextra",
    "-pedantic",
    "-Wshadow",
    "-Wconversion",
    "-Werror",
]
BY_CHANNEL = {"actions": ["fading", "channel_noise"], "observation": "full"}


def perceptron(path, env_id, algorithm="ppo", activation="tanh", **env_kwargs):
    """An untrained policy of the kind that PPO and SAC leave."""
    fits = NumpyPolicy.load(trained_on(path, env_id, "mlp-log-factors", **env_kwargs))
    d, k, h = fits.observation_size, fits.action_size, (8, 6)
    rng, arrays = np.random.default_rng(0), {"kind": "mlp", "layers": 3}
    for i, (rows, columns) in enumerate(zip((d, *h), (*h, k), strict=True)):
        arrays[f"weight_{i}"] = rng.standard_normal((rows, columns)).astype(np.float32)
        arrays[f"bias_{i}"] = rng.standard_normal(columns).astype(np.float32)
    arrays |= {"algorithm": algorithm, "activation": activation}
    arrays |= {"low": -np.ones(k, np.float32), "high": np.ones(k, np.float32)}
    told = {"env_id": env_id, "env_kwargs": env_kwargs, "features": fits.features}
    return write_policy(path, arrays, told | {"knobs": fits.knobs})


def by_channel(path):
    """One network for all satellites, whose first and last are siblings of all the others."""
    fits = NumpyPolicy.load(trained_on(path, GNSS, **short(GNSS, **BY_CHANNEL)))
    d, k = fits.observation_size, fits.action_size
    inputs, outputs = np.arange(d // 2 * 2).reshape(2, -1), np.arange(k // 2 * 2).reshape(2, -1)
    inputs = np.hstack([inputs, np.full((2, 1), d - 1)])
    outputs = np.hstack([outputs, np.full((2, 1), k - 1)])
    arrays = random_arrays("gru", inputs.shape[1], outputs.shape[1])
    arrays |= {"kind": "gru-by-channel", "inputs": inputs, "outputs": outputs}
    told = {"env_id": GNSS, "env_kwargs": fits.env_kwargs, "features": fits.features}
    return write_policy(path, arrays, told | {"knobs": fits.knobs})


def gru(path):
    return trained_on(path, BISTATIC, "gru", observation="full", duration=20.0)


POLICIES = {
    "gru": gru,
    "memoryless": lambda path: trained_on(path, BISTATIC, "mlp-log-factors"),
    "ppo": lambda path: perceptron(path, BISTATIC),
    "sac": lambda path: perceptron(path, BISTATIC, "sac", "relu"),
    "by-channel": by_channel,
}


@pytest.fixture
def deployable(request, tmp_path):
    return Deployable.find(str(POLICIES[request.param](tmp_path / "policy.npz")))


# ----- ONNX -------------------------------------------------------------------------------


@pytest.mark.parametrize("deployable", POLICIES, indirect=True)
@pytest.mark.parametrize("batch", [1, 7])
def test_onnx_decides_as_numpy_does(deployable, batch, tmp_path):
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    export_policy(deployable, "onnx", tmp_path)
    session = runtime.InferenceSession(tmp_path / "policy.onnx")
    policy, rng = deployable.policy, np.random.default_rng(0)
    memory, turned = policy.start(batch), []
    for scale in (0.1, 1.0, 3.0, 100.0):
        size = (batch, policy.observation_size)
        seen = (scale * rng.standard_normal(size)).astype(np.float32)
        given = {"observation": seen} | ({"memory": memory} if memory.size else {})
        action, knobs, *after = session.run(None, given)
        wanted, memory = policy.decide(seen, memory)
        np.testing.assert_allclose(action, wanted, rtol=0.0, atol=1e-5)
        if memory.size:
            np.testing.assert_allclose(after[0], memory, rtol=0.0, atol=1e-5)
        low, high = np.array([(knob.low, knob.high) for knob in policy.knobs]).T
        factors = np.where(wanted >= 0.0, high**wanted, low**-wanted)
        np.testing.assert_allclose(knobs, factors, rtol=2e-4)
        turned.append(action)
    assert np.ptp(turned) > 0.3


def test_onnx_names_its_ends_and_carries_the_contract(tmp_path):
    onnx = pytest.importorskip("onnx")
    deployable = Deployable.find(str(gru(tmp_path / "policy.npz")))
    export_policy(deployable, "onnx", tmp_path / "out")
    model = onnx.load(tmp_path / "out" / "policy.onnx")
    assert [end.name for end in model.graph.input] == ["observation", "memory"]
    assert [end.name for end in model.graph.output] == ["action", "knobs", "next_memory"]
    assert all(end.type.tensor_type.shape.dim[0].dim_param == "batch" for end in model.graph.input)
    told = {item.key: item.value for item in model.metadata_props}
    assert json.loads(told["kfenv_contract"]) == contract(deployable)


# ----- the contract and the arrays ----------------------------------------------------------


@pytest.mark.parametrize("deployable", POLICIES, indirect=True)
def test_the_contract_names_every_feature_and_knob(deployable, tmp_path):
    export_policy(deployable, "npz", tmp_path / "out")
    told = json.loads((tmp_path / "out" / "contract.json").read_text())
    policy, text = deployable.policy, (tmp_path / "out" / "contract.md").read_text()
    assert [feature["name"] for feature in told["observation"]] == [*policy.features]
    ranges = [(knob["name"], knob["low"], knob["high"]) for knob in told["knobs"]]
    assert ranges == [(knob.name, knob.low, knob.high) for knob in policy.knobs]
    assert told["memory"]["size"] == policy.network.memory_size
    for name in (*policy.features, *(knob["multiplies"] for knob in told["knobs"])):
        assert name in text
    assert text == page(told)
    copy = NumpyPolicy.load(tmp_path / "out" / "policy.npz")
    assert copy.digest == policy.digest and copy.features == policy.features


def test_what_is_normalised_is_what_the_network_does(tmp_path):
    deployable = Deployable.find(str(gru(tmp_path / "policy.npz")))
    rows = contract(deployable)["observation"]
    network = deployable.policy.network
    assert np.float32([row["mean"] for row in rows]).tolist() == network.mean.tolist()
    assert np.float32([row["deviation"] for row in rows]).tolist() == network.deviation.tolist()
    plain = contract(Deployable.find(str(perceptron(tmp_path / "ppo.npz", BISTATIC))))
    assert "mean" not in plain["observation"][0]


@pytest.mark.parametrize("env_id, name, what", [
    (BISTATIC, "x_noise", "the told standard deviation of x"),
    (GNSS, "pseudorange_noise", "the told standard deviation of rho_1, rho_2"),
    (INERTIAL, "process_noise", "the covariance Q"),
    (INERTIAL, "bias_process_noise", "the process noise's covariance of "),
])  # fmt: skip
def test_a_knob_tells_what_it_multiplies(env_id, name, what, tmp_path):
    kwargs = short(env_id, **({"biases": True} if env_id == INERTIAL else {}))
    deployable = Deployable.find(str(trained_on(tmp_path / "policy.npz", env_id, **kwargs)))
    [knob] = [knob for knob in contract(deployable)["knobs"] if knob["name"] == name]
    assert knob["multiplies"].startswith(what)


# ----- C --------------------------------------------------------------------------------


def compiled(folder, *more, test="kfenv_test.c"):
    """The exported test as a program."""
    if COMPILER is None:
        pytest.skip("there is no C compiler")
    program = folder / "kfenv_test"
    command = [COMPILER, *WARNINGS, *more, test, "kfenv_policy.c", "-lm", "-o", str(program)]
    subprocess.run(command, cwd=folder, check=True)
    return program


def run(program, *arguments):
    return subprocess.run([program, *arguments], capture_output=True, text=True)


SCALED = {
    "motion": "kfenv.models.constant_acceleration:constant_acceleration",
    "sensor": "kfenv.models.radar:radar", "scored": ["x", "z"], "scored_rates": ["vx", "vz"],
    "scale": [10.0, 20.0], "R": [4.0, 1e-4, 1e-4], "mean": [900.0, 10.0, 1.0] * 3, "P": [1.0] * 9,
}  # fmt: skip
C_POLICIES = {
    "full, with memory": gru,
    "short": lambda path: trained_on(path, VALIDATION, "mlp-log-factors", **short(VALIDATION)),
    "ppo": lambda path: perceptron(path, BISTATIC),
    "sac": lambda path: perceptron(path, BISTATIC, "sac", "relu", observation="full"),
    "without acceleration, a decision for four steps": lambda path: trained_on(
        path, INERTIAL, observation="full", **short(INERTIAL, rate=20.0, measurement_rate=5.0)
    ),
    "what is scored has no rates": lambda path: trained_on(
        path, OWN, observation="full", **short(OWN)
    ),
    "each of what is scored has a scale": lambda path: trained_on(
        path, OWN, "mlp-log-factors", observation="full", **short(OWN, **SCALED)
    ),
    "knobs of single channels": lambda path: trained_on(
        path, GNSS, observation="full", actions=["fading", "channel_noise"], **short(GNSS)
    ),
    "knobs of single channels, curved": lambda path: trained_on(
        path,
        VALIDATION,
        "mlp-log-factors",
        actions=["fading", "channel_noise"],
        **short(VALIDATION),
    ),
    "one network for all satellites": by_channel,
    "many channels": lambda path: trained_on(path, GNSS, observation="full", **short(GNSS)),
}


@pytest.mark.parametrize("kind", C_POLICIES)
def test_c_computes_features_and_knobs_as_numpy_does(kind, tmp_path):
    deployable = Deployable.find(str(C_POLICIES[kind](tmp_path / "policy.npz")))
    export_policy(deployable, "c", tmp_path)
    told = run(compiled(tmp_path))
    assert told.returncode == 0, told.stdout + told.stderr
    steps, knobs, features = re.match(
        r"(\d+) steps: knobs at most (\S+) off, features (\S+)\n", told.stdout
    ).groups()
    assert int(steps) >= 20 and float(knobs) < 1e-9 and float(features) < 1e-9
    vectors = golden(deployable)
    assert np.isnan([now.innovation for now in vectors.instants]).any()
    assert np.ptp(np.log(vectors.knobs), axis=0).max() > 0.3


def test_the_learned_agent_in_c(tmp_path):
    """The small one; in single precision, too, and with the time of a step."""
    export_policy(Deployable.find("learned-small", TRACKING), "c", tmp_path)
    told = run(compiled(tmp_path, "-O3"), "--bench")
    assert told.returncode == 0 and re.search(r"a step takes \d+\.\d+ us", told.stdout)
    single = run(compiled(tmp_path, "-O3", "-DKFENV_REAL=float", "-DTOLERANCE=1e-4"))
    assert single.returncode == 0, single.stdout


def test_the_test_in_c_can_fail(tmp_path):
    export_policy(Deployable.find(str(gru(tmp_path / "policy.npz"))), "c", tmp_path)
    source = tmp_path / "kfenv_policy.c"
    source.write_text(source.read_text().replace("#define PRODUCTS 10.0", "#define PRODUCTS 10.1"))
    told = run(compiled(tmp_path))
    assert told.returncode == 1 and "FAILED" in told.stdout


REFUSALS = """
#include "kfenv_golden.h"
#include <stdio.h>
#include <string.h>

int main(void)
{
    kfenv_state state, before;
    double knobs[KFENV_KNOBS];
    kfenv_reset(&state);
    kfenv_step(&state, &golden_instants[0], knobs);
    before = state;
    for (int i = 0; i < 5; i++) {
        kfenv_instant now = golden_instants[1];
        now.innovation[0] = 1.0;
        if (i == 0) now.noise[1] = 0.0;
        if (i == 1) now.dt = -1.0;
        if (i == 2) now.covariance[0][0] = -1.0;
        if (i == 3) now.distance = NAN;
        printf("%d", kfenv_step(&state, &now, knobs));
        if (i < 4) printf("%d", memcmp(&state, &before, sizeof state));
    }
    return 0;
}
"""


def test_c_refuses_what_makes_no_sense(tmp_path):
    export_policy(Deployable.find(str(gru(tmp_path / "policy.npz"))), "c", tmp_path)
    (tmp_path / "refusals.c").write_text(REFUSALS)
    assert run(compiled(tmp_path, test="refusals.c")).stdout == "10101010" + "0"


def test_double_precision_is_the_loop_of_the_environment(tmp_path):
    """The golden knobs are, within single precision, what a tuned filter sets."""
    policy = trained_on(tmp_path / "policy.npz", BISTATIC, "mlp-log-factors", duration=20.0)
    deployable = Deployable.find(str(policy))
    vectors = golden(deployable)
    tuned = TunedFilter(BISTATIC, policy, duration=20.0)
    whole = deployable.loop.scenario.sample([np.random.default_rng(0)])
    tuned.reset(whole.mean[0], whole.factor[0])
    for t, now in enumerate(vectors.instants):
        z = np.where(np.isnan(now.innovation), np.nan, whole.measurement[0, t])
        knobs = tuned.step(z, now.dt, noise=now.noise).knobs
        np.testing.assert_allclose([*knobs.values()], vectors.knobs[t], rtol=1e-4)


class Instant(ctypes.Structure):
    """As the header has it for the bistatic case."""

    _fields_ = (
        ("innovation", ctypes.c_double * 3), ("covariance", ctypes.c_double * 9),
        ("noise", ctypes.c_double * 3), ("dt", ctypes.c_double), ("deviation", ctypes.c_double),
        ("rate_deviation", ctypes.c_double), ("distance", ctypes.c_double),
        ("rate", ctypes.c_double * 3), ("acceleration", ctypes.c_double * 3),
    )  # fmt: skip


def in_c(policy, x, P, H, z, R, dt):
    """The knobs that the library sets for a textbook filter's prediction."""
    S, places = H @ P @ H.T + R, (slice(0, None, 3), slice(1, None, 3), slice(2, None, 3))
    deviation, rate_deviation = (np.sqrt(np.trace(P[p, p])) for p in places[:2])
    now = Instant(
        tuple(z - H @ x), tuple(S.ravel()), tuple(np.sqrt(np.diag(R))), dt, deviation,
        rate_deviation, np.linalg.norm(x[places[0]]), tuple(x[places[1]]), tuple(x[places[2]]),
    )  # fmt: skip
    library, state, knobs = policy
    assert library.kfenv_step(state, ctypes.byref(now), knobs) == 0
    return np.array(knobs)


def test_a_textbook_filter_with_the_policy_in_c_is_the_tuned_filter(tmp_path):
    """Each knob multiplies what the contract says: covariance-form Kalman filter, linear model."""
    path = trained_on(
        tmp_path / "policy.npz", BISTATIC, "mlp-log-factors", observation="full", duration=20.0
    )
    deployable = Deployable.find(str(path))
    export_policy(deployable, "c", tmp_path)
    if COMPILER is None:
        pytest.skip("there is no C compiler")
    build = [COMPILER, "-std=c99", "-shared", "-fPIC", "kfenv_policy.c", "-lm", "-o", "policy.so"]
    subprocess.run(build, cwd=tmp_path, check=True)
    library, state = ctypes.CDLL(str(tmp_path / "policy.so")), ctypes.create_string_buffer(1 << 16)
    library.kfenv_reset(state)
    policy = library, state, (ctypes.c_double * 5)()
    dt, one = 0.5, np.eye(3)
    H, F = np.kron(one, [1.0, 0.0, 0.0]), np.kron(one, [[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
    Q = 0.2 * np.kron(one, [
        [dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2],
        [dt**3 / 6, dt**2 / 2, dt],
    ])  # fmt: skip
    recording = deployable.loop.scenario.sample([np.random.default_rng(2)])
    tuned = TunedFilter(BISTATIC, path)
    tuned.reset(recording.mean[0], recording.factor[0])
    x, P, noise = recording.mean[0], recording.factor[0] @ recording.factor[0].T, np.zeros((9, 9))
    for z, told in zip(recording.measurement[0], recording.noise[0], strict=True):
        knobs = in_c(policy, x, P + noise, H, z, np.diag(told**2), dt)
        here, told_to_it = ~np.isnan(z), told * knobs[2:]
        P, h = knobs[0] * P + knobs[1] * noise, H[here]
        K = np.linalg.solve(h @ P @ h.T + np.diag(told_to_it[here] ** 2), h @ P).T
        x, P = x + K @ (z[here] - h @ x), P - K @ h @ P
        step = tuned.step(z, dt, noise=told)
        np.testing.assert_allclose(knobs, [*step.knobs.values()], rtol=1e-3)
        np.testing.assert_allclose(x, step.estimate, rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(np.diag(P), np.diag(step.covariance), rtol=1e-2)
        x, P, noise = F @ x, F @ P @ F.T, Q
    assert np.ptp(np.log(knobs)) > 0.1


# ----- at the door ---------------------------------------------------------------------------


def kfenv(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments)])


def test_the_command_writes_the_files_and_says_how_to_test_them(tmp_path):
    result = kfenv("learned-small", "--env", BISTATIC, "--to", "c", "--output", tmp_path / "c")
    assert result.exit_code == 0, result.output
    for name in ("kfenv_policy.h", "kfenv_policy.c", "kfenv_golden.h", "contract.md"):
        assert (tmp_path / "c" / name).stat().st_size > 1000 and name in result.output
    assert "./kfenv_test --bench" in result.output
    again = kfenv("learned-small", "--env", BISTATIC, "--to", "npz", "--output", tmp_path / "c")
    assert again.exit_code == 2 and "is not empty: name another" in again.output
    assert not (tmp_path / "c" / "policy.npz").exists()


@pytest.mark.parametrize("arguments, said", [
    (["learned", "--env", BISTATIC, "--to", "onix"], "Did you mean 'onnx'"),
    (["learned", "--to", "npz"], "'learned' is no trained policy"),
    (["hmm-noise", "--env", BISTATIC, "--to", "npz"], "'hmm-noise' is no trained policy"),
    (["learned", "--env", OWN, "--to", "npz"], "comes with kfenv for Filter"),
    (["nowhere.npz", "--to", "npz"], "Unknown agent"),
])  # fmt: skip
def test_what_cannot_be_exported_is_told(arguments, said, tmp_path):
    result = kfenv(*arguments, "--output", tmp_path / "out")
    assert result.exit_code == 2
    assert said in result.output
    assert not (tmp_path / "out").exists()


def test_a_policy_that_fits_no_environment_is_told(tmp_path):
    path = write_policy(tmp_path / "policy.npz", random_arrays("gru"), about())
    with pytest.raises(ValueError, match="Unknown environment 'Nowhere-v0'"):
        Deployable.find(str(path))
