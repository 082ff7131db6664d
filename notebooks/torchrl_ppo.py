"""PPO of TorchRL on radar tracking: ``python torchrl_ppo.py STEPS POLICY.npz``, to be contested."""

import sys

import gymnasium as gym
import torch
from kfenv.agents.contestants.policy import write_perceptron
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torchrl import collectors, envs, modules, objectives

NAME, WITH = "kfenv:kfenv/RadarTracking-v0", {"rate": 2.0, "reward": "improvement"}
env = envs.GymWrapper(gym.make_vec(NAME, 256, autoreset_mode="same_step", info="none", **WITH))
mean, value = (modules.MLP(29, outputs, num_cells=[64, 64]) for outputs in (10, 1))
policy = torch.nn.Sequential(mean, NormalParamExtractor("biased_softplus_0.37"))
actor = modules.ProbabilisticActor(
    TensorDictModule(policy, ["observation"], ["loc", "scale"]), in_keys=["loc", "scale"],
    distribution_class=modules.IndependentNormal, return_log_prob=True)  # fmt: skip
loss = objectives.ClipPPOLoss(actor, modules.ValueOperator(value), normalize_advantage=True)
loss.make_value_estimator(gamma=0.95, lmbda=0.95)
optimiser, steps = torch.optim.Adam(loss.parameters(), 2e-3), int(sys.argv[1])
for batch in collectors.Collector(env, actor, frames_per_batch=32768, total_frames=steps):
    for _ in range(4):
        loss.value_estimator(batch, params=loss.critic_network_params)
        for part in batch.reshape(-1)[torch.randperm(batch.numel())].split(8192):
            optimiser.zero_grad()
            sum(map(loss(part).get, ("loss_objective", "loss_critic"))).backward()
            optimiser.step()
    print("mean reward", batch["next", "reward"].mean().item(), flush=True)
layers = [[x.detach().numpy() for x in layer.parameters()] for layer in list(mean)[::2]]
write_perceptron(sys.argv[2], layers, 5, NAME, WITH)  # five means; the rest are deviations
