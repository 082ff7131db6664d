"""A taught policy equals torch's, keeps each episode's memory apart, and knows its environment."""

import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kfenv.agents.contest.rollout import draw_episodes, rollout, scenario_and_options
from kfenv.agents.contestants.channelwise import siblings
from kfenv.agents.contestants.learned import Learned
from kfenv.agents.contestants.policy import NumpyPolicy, write_policy
from policies import RADAR, about, random_arrays, random_policy, trained_on

from kfenv.envs.core import Core
from kfenv.envs.knobs import Knob, actions_for

KINDS = ("gru", "mlp-log-factors")
BATCH, STEPS = 5, 50


@pytest.fixture
def observations():
    return np.random.default_rng(1).normal(0.0, 3.0, (STEPS, BATCH, 9)).astype(np.float32)


def decide_all(policy, observations):
    state, actions = policy.start(observations.shape[1]), []
    for seen in observations:
        action, state = policy.decide(seen, state)
        actions.append(action)
    return np.array(actions), state


# ----- arithmetic


@pytest.mark.parametrize("kind", KINDS)
def test_numpy_equals_torch(kind, tmp_path, observations):
    torch = pytest.importorskip("torch")
    from kfenv.agents.learning.networks import RecurrentNetwork

    policy = random_policy(tmp_path / "policy.npz", kind)
    network = RecurrentNetwork.from_policy(policy)
    with torch.no_grad():
        whole, last = network(torch.tensor(observations), network.start(BATCH))
        part, state = network(torch.tensor(observations[:20]), network.start(BATCH))
        rest, state = network(torch.tensor(observations[20:]), state)
    np.testing.assert_allclose(torch.cat((part, rest)), whole, atol=1e-6)
    knobs = [Knob(*knob) for knob in about()["knobs"]]
    actions, memory = decide_all(policy, observations)
    np.testing.assert_allclose(actions, actions_for(np.exp(whole.numpy()), knobs), atol=1e-5)
    np.testing.assert_allclose(memory, last, atol=1e-5)
    assert actions.dtype == memory.dtype == np.float32
    clipped = (whole == network.log_low) | (whole == network.log_high)
    assert 0.01 < clipped.float().mean() < 0.9  # the comparison saw both


@pytest.mark.parametrize("kind", KINDS)
def test_torch_gives_back_what_it_was_given(kind, tmp_path):
    pytest.importorskip("torch")
    from kfenv.agents.learning.networks import RecurrentNetwork

    policy = random_policy(tmp_path / "policy.npz", kind)
    arrays = RecurrentNetwork.from_policy(policy).arrays()
    arrays = {name: arrays[name] for name in random_arrays(kind)}  # in the same order
    again = write_policy(tmp_path / "again.npz", arrays, about())
    assert again.read_bytes() == (tmp_path / "policy.npz").read_bytes()


@pytest.fixture
def by_channel(tmp_path):
    """Two siblings of three features each, of which one is common, and a common knob."""
    arrays = random_arrays("gru", features=3, knobs=2) | {
        "kind": "gru-by-channel",
        "inputs": np.array([[0, 1, 2], [0, 3, 4]]), "outputs": np.array([[0, 1], [0, 2]]),
    }  # fmt: skip
    knobs = [("fading", 0.01, 100.0), ("one", 0.05, 500.0), ("other", 0.05, 500.0)]
    return NumpyPolicy.load(
        write_policy(tmp_path / "by.npz", arrays, about(features=5) | {"knobs": knobs})
    )


def about_siblings(policy):
    return about(features=5) | {"knobs": [(k.name, k.low, k.high) for k in policy.knobs]}


def test_siblings_share_a_network_and_each_has_its_own_memory(by_channel, observations):
    torch = pytest.importorskip("torch")
    from kfenv.agents.learning.channelwise import trainable

    seen = observations[:, :, :5]
    actions, memory = decide_all(by_channel, seen)
    network = trainable(by_channel)
    with torch.no_grad():
        logs, last = network(torch.tensor(seen), network.start(BATCH))
    np.testing.assert_allclose(
        actions, actions_for(np.exp(logs.numpy()), by_channel.knobs), atol=1e-5
    )
    np.testing.assert_allclose(memory, last, atol=1e-5)
    turned, _ = decide_all(by_channel, seen[..., [0, 3, 4, 1, 2]])
    np.testing.assert_allclose(turned, actions[..., [0, 2, 1]], atol=1e-6)
    alone, _ = by_channel.network.each.log_factors(seen[0][:, [0, 3, 4]], np.zeros((BATCH, 12)))
    wanted = actions_for(np.exp(alone), by_channel.knobs[1:])
    np.testing.assert_allclose(actions[0, :, 2], wanted[:, 1], atol=1e-5)
    assert network.arrays().keys() == {
        *random_arrays("gru", 3, 2), "inputs", "outputs"
    }  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        {"inputs": np.array([[0, 1, 2], [0, 1, 2]]) + 1},
        {"inputs": np.array([[0, 1, 2]])},
        {"inputs": np.array([[0.0, 1.0, 2.0], [0.0, 3.0, 4.0]])},
        {"outputs": np.array([[0, 1], [0, 5]])},
        {"outputs": np.array([[0, 1], [0, 1]])},
        {"outputs": np.array([[0, 1], [0, -1]])},
    ],
)
def test_siblings_that_do_not_fit_are_refused(by_channel, tmp_path, change):
    source, each = by_channel.network, by_channel.network.each
    arrays = random_arrays("gru", 3, 2) | {"kind": source.kind}
    arrays |= {"inputs": source.inputs, "outputs": source.outputs}
    write_policy(tmp_path / "sound.npz", arrays, about_siblings(by_channel))
    with pytest.raises(ValueError, match=r"knobs|features|places|shape"):
        write_policy(tmp_path / "wrong.npz", arrays | change, about_siblings(by_channel))
    assert each.memory_size == 12


def test_the_siblings_of_a_receiver_are_its_satellites():
    scenario, options = scenario_and_options(
        "kfenv/GnssTracking-v0", {"observation": "full", "actions": ["fading", "channel_noise"]}
    )
    core = Core(scenario, options, 1, scenario.time, has_truth=True)
    features, knobs = core.feature_names(), [knob.name for knob in core.knobs]
    inputs, outputs = siblings(features, knobs, scenario.sensor)
    assert [knobs[k] for k in outputs[4]] == ["fading", "rho_5", "rhodot_5"]
    own = [features[i] for i in inputs[4] if i not in inputs[5]]
    assert own and all("rho_5" in name.split() or "rhodot_5" in name.split() for name in own)
    common = [features[i] for i in inputs[4] if i in inputs[5]]
    assert "previous action: fading" in common and not any("rho" in name for name in common)
    assert siblings(features, ["fading"], scenario.sensor) is None


def test_a_head_can_be_set_and_bounds_leave_a_gradient():
    torch = pytest.importorskip("torch")
    from kfenv.agents.learning.networks import RecurrentNetwork

    network = RecurrentNetwork(np.zeros(4), np.ones(4), [-1.0, -1.0], [1.0, 1.0], hidden=8)
    network.set_head(1, weight=0.0, bias=np.log(2.5))
    factors, state = network(torch.randn(6, 3, 4), network.start(3))
    assert state.shape == (3, 8)
    np.testing.assert_allclose(factors[..., 1].detach(), np.log(2.5), rtol=1e-6)
    network.set_head(1, weight=0.0, bias=7.0)
    factors, _ = network(torch.randn(6, 3, 4), network.start(3))
    assert (factors[..., 1] == 1.0).all()
    factors[..., 1].sum().backward()
    assert 0.0 < network.head.bias.grad[1] < 0.5 * 18


@pytest.mark.parametrize("kind", KINDS)
def test_single_equals_batched(kind, tmp_path, observations):
    policy = random_policy(tmp_path / "policy.npz", kind)
    actions, memory = decide_all(policy, observations)
    state = policy.start(1)
    for seen, wanted in zip(observations[:, 2], actions[:, 2], strict=True):
        action, state = policy.decide(seen, state)
        assert action.shape == (3,)
        np.testing.assert_allclose(action, wanted, atol=1e-5)
    np.testing.assert_allclose(state[0], memory[2], atol=1e-5)


def test_features_are_cut_at_five_deviations(tmp_path):
    policy = random_policy(tmp_path / "policy.npz", "mlp-log-factors")
    network = policy.network
    edge = network.mean + 5.0 * network.deviation
    np.testing.assert_array_equal(
        policy.predict(edge + 1e6 * np.eye(9)), np.broadcast_to(policy.predict(edge), (9, 3))
    )


def test_forgetting_begins_one_episode_anew_and_no_other(tmp_path, observations):
    policy = random_policy(tmp_path / "policy.npz")
    _, state = decide_all(policy, observations[:10])
    before, mask = state.copy(), np.arange(BATCH) == 3
    state = policy.forget(state, mask)
    np.testing.assert_array_equal(state[~mask], before[~mask])
    seen = observations[10]
    fresh, _ = policy.decide(seen, policy.start(BATCH))
    going_on, _ = policy.decide(seen, before)
    after, _ = policy.decide(seen, state)
    np.testing.assert_array_equal(after[mask], fresh[mask])
    np.testing.assert_array_equal(after[~mask], going_on[~mask])
    assert np.abs(fresh - going_on).max() > 0.01  # the memory matters


def test_a_memory_cannot_be_left_out(tmp_path):
    with pytest.raises(ValueError, match="has a memory"):
        random_policy(tmp_path / "policy.npz").predict(np.zeros(9))


# ----- as an agent


def test_an_agent_begins_each_contest_without_memory(tmp_path):
    agent = Learned(trained_on(tmp_path / "policy.npz", RADAR, rate=2, duration=20))
    place = (RADAR, {"rate": 2, "duration": 20})
    episodes = draw_episodes(*place, "test", 0, 3)
    first, second = rollout(agent, *place, episodes), rollout(agent, *place, episodes)
    np.testing.assert_array_equal(first.rmse, second.rmse)


def test_an_agent_keeps_to_the_same_environment(tmp_path):
    agent = Learned(trained_on(tmp_path / "policy.npz", RADAR, rate=2, duration=20))
    for kwargs in ({}, {"rate": 10, "duration": 30, "faults": "random", "actions": ("fading",)}):
        assert _refusal(agent, RADAR, **kwargs) is None  # knobs are the policy's own


@pytest.mark.parametrize(("own", "others"), [("short", "full"), ("full", "short")])
def test_an_agent_brings_its_own_observation(own, others, tmp_path):
    given = {"observation": own} if own != "short" else {}  # a policy may take it for granted
    agent = Learned(trained_on(tmp_path / "policy.npz", RADAR, rate=2, duration=20, **given))
    assert _refusal(agent, RADAR, observation=others) is None
    place = {"rate": 2, "duration": 20, "observation": others}
    scores = rollout(agent, RADAR, place, draw_episodes(RADAR, place, "test", 0, 2))
    assert np.isfinite(scores.rmse).all()


@pytest.mark.parametrize("name", ["RadarValidation", "BistaticTracking", "InsGnss"])
def test_another_environment_refuses_it_and_says_why(name, tmp_path):
    agent = Learned(trained_on(tmp_path / "walker.npz", RADAR))
    said = _refusal(agent, f"kfenv/{name}-v0")
    assert said == f"The policy walker was trained on {RADAR}, and this is {name}."


def test_another_observation_or_knob_refuses_it_and_says_which(tmp_path):
    path = trained_on(tmp_path / "policy.npz", RADAR)
    arrays = random_arrays("gru", Learned(path).policy.observation_size, 5)
    policy = NumpyPolicy.load(path)
    told = {"env_id": RADAR, "env_kwargs": {}, "features": policy.features, "knobs": policy.knobs}

    def refusal(**changes):
        return _refusal(Learned(write_policy(path, arrays, told | changes)), RADAR)

    assert refusal() is None
    assert "its observation had" in refusal(env_kwargs={"observation": "full"})
    features = ("other", *policy.features[1:])
    assert "its observation had 'other' where there is 'range:" in refusal(features=features)
    knobs = (Knob("fading", 0.5, 20.0), *policy.knobs[1:])
    assert "had 'fading from 0.5 to 20' where there is 'fading from 0.5" in refusal(knobs=knobs)
    assert "its options are refused: " in refusal(env_kwargs={"decision_interval": "long"})
    assert "its options are refused: " in refusal(env_kwargs={"actions": [3]})
    arrays = random_arrays("gru", 7, 5)
    said = refusal(features=[])
    assert "its observation had 7 numbers and would have" in said and said.count(". ") == 0


def _refusal(agent, env_id, **env_kwargs):
    scenario, options = scenario_and_options(env_id, env_kwargs)
    try:
        agent.check(scenario, options, draw_episodes(env_id, env_kwargs, "test", 0, 1))
    except ValueError as error:
        return str(error)


# ----- files


@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_says_what_it_is(kind, tmp_path):
    policy = random_policy(tmp_path / "policy.npz", kind)
    assert policy.network.kind == kind
    assert (policy.observation_size, policy.action_size) == (9, 3)
    assert policy.start(4).shape == (4, 12 if kind == "gru" else 0)
    assert (policy.env_id, policy.env_kwargs) == ("Nowhere-v0", {"rate": 2})
    assert policy.features[8] == "feature 8" and policy.knobs[2] == Knob("knob 2", 0.01, 300.0)
    assert policy.metadata == {"note": "a test"}


def test_the_former_format_is_read(tmp_path):
    """Written as the version before wrote it."""
    rng = np.random.default_rng(2)
    weights, low, high = rng.standard_normal((7, 3)), -np.ones(3), np.array([1.0, 2.0, 3.0])
    np.savez(
        tmp_path / "policy.npz", format="kfenv-policy-1", algorithm="ppo", activation="tanh",
        layers=1, observation_size=7, action_size=3, low=low, high=high, env_id=RADAR,
        env_kwargs=json.dumps({"rate": 2}), metadata=json.dumps({"seed": 1}),
        weight_0=weights.astype(np.float32), bias_0=np.zeros(3, np.float32),
    )  # fmt: skip
    agent = Learned(tmp_path / "policy.npz")
    seen = rng.standard_normal((4, 7)).astype(np.float32)
    np.testing.assert_allclose(agent.policy.predict(seen), np.clip(seen @ weights, low, high), 1e-5)
    assert (agent.policy.features, agent.policy.knobs) == ((), ())
    assert "its observation had 7 numbers" in _refusal(agent, RADAR)
    assert "this is GnssTracking" in _refusal(agent, "kfenv/GnssTracking-v0")


@pytest.mark.parametrize(
    ("arrays", "told"),
    [
        ({"kind": "lstm"}, {}),
        ({"kind": "mlp"}, {}),
        ({"kind": "mlp-log-factors"}, {}),
        ({"log_low": np.full(3, np.nan)}, {}),
        ({"log_low": np.full(3, 1.5)}, {}),
        ({"log_high": np.full(2, 1.5)}, {}),
        ({"deviation": np.zeros(9)}, {}),
        ({"mean": np.full(9, np.inf)}, {}),
        ({"mean": np.full(9, 1e300)}, {}),
        ({"mean": np.zeros(9, complex)}, {}),
        ({"mean": np.zeros((3, 3))}, {}),
        ({"weight_hh": np.zeros((12, 12))}, {}),
        ({"bias_ih": np.zeros(12)}, {}),
        ({}, {"features": ["a", "b"]}),
        ({}, {"features": ["a"] * 9}),
        ({}, {"features": range(9)}),
        ({}, {"knobs": []}),
        ({}, {"knobs": about()["knobs"][:2]}),
        ({}, {"knobs": [(f"knob {i}", 2.0, 3.0) for i in range(3)]}),
        ({}, {"knobs": [(f"knob {i}", 0.5, np.inf) for i in range(3)]}),
        ({}, {"knobs": [(f"knob {i}", 0.5) for i in range(3)]}),
        ({}, {"env_kwargs": [1]}),
        ({}, {"env_kwargs": {"faults": object()}}),
        ({}, {"env_id": 3}),
        ({}, {"metadata": "none"}),
        ({}, {"more": 1}),
    ],
)
def test_what_does_not_belong_together_is_neither_written_nor_read(arrays, told, tmp_path):
    path = tmp_path / "policy.npz"
    with pytest.raises((ValueError, TypeError, KeyError)):
        write_policy(path, random_arrays("gru") | arrays, about(**told))
    assert not path.exists()
    try:
        text = json.dumps(about(**told))
    except TypeError:
        return
    np.savez(path, format="kfenv-policy-2", about=text, **random_arrays("gru") | arrays)
    _assert_refused(path)


def _assert_refused(path):
    with pytest.raises(ValueError, match=r"is not a policy of kfenv or is damaged") as caught:
        NumpyPolicy.load(path)
    assert "\n" not in str(caught.value) and path.name in str(caught.value)


def test_a_file_takes_no_more_memory_than_it_has_bytes(tmp_path):
    path = tmp_path / "policy.npz"
    np.savez_compressed(path, mean=np.zeros(10_000_000))  # 10 kB
    with pytest.raises(ValueError, match="compressed"):
        NumpyPolicy.load(path)
    for shape in ("(1000000000000,)", "(-1,)", "(1000000, 1000000, 1000000, 10000000)"):
        header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
        member = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("mean.npy", member + bytes(12))
            archive.writestr("format.npy", member + bytes(12))
        _assert_refused(path)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_damaged_file_is_refused_or_still_decides(data, tmp_path_factory):
    """The checksums of the archive let hardly anything through; then it must hold numbers."""
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    whole = WHOLE.setdefault("file", _whole(path))
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(damaged) - 1))
        damaged[place] = data.draw(st.integers(0, 255))
    path.write_bytes(damaged[: data.draw(st.sampled_from([len(damaged), len(damaged) // 2]))])
    try:
        policy = NumpyPolicy.load(path)
    except ValueError as error:
        assert "is damaged" in str(error)
    else:
        actions, _ = policy.decide(np.ones((2, 9)), policy.start(2))
        assert np.isfinite(actions).all()


WHOLE = {}


def _whole(path):
    random_policy(path)
    return path.read_bytes()
