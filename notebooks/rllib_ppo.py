"""PPO of RLlib on radar tracking: ``python rllib_ppo.py STEPS POLICY.npz``, to be contested."""

import sys

import gymnasium as gym
from kfenv.agents.contestants.policy import write_perceptron
from kfenv.agents.learning.rllib import WorkerStreams
from ray.rllib.algorithms.ppo import PPOConfig

NAME, KEYWORDS = "kfenv/RadarTracking-v0", {"rate": 2.0, "reward": "improvement"}
LAYERS = ("encoder.actor_encoder.net.mlp.0", "encoder.actor_encoder.net.mlp.2", "pi.net.mlp.0")

config = PPOConfig().environment(f"kfenv:{NAME}", env_config=KEYWORDS | {"info": "none"})
config.env_runners(num_env_runners=1, num_envs_per_env_runner=256, rollout_fragment_length=128,
                   gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT,
                   sample_timeout_s=600.0)  # fmt: skip
config.training(train_batch_size=32768, minibatch_size=8192, num_epochs=4, lr=2e-3, gamma=0.95)
config.rl_module(model_config={"fcnet_hiddens": [64, 64], "fcnet_activation": "tanh"})
config.callbacks(on_environment_created=WorkerStreams(seed=0)).debugging(seed=None)
algorithm, steps = config.build_algo(), 0
while steps < int(sys.argv[1]):
    steps = algorithm.train()["num_env_steps_sampled_lifetime"]
    print(f"{steps:.0f} steps", flush=True)

weights = algorithm.get_module().get_state()
layers = [[weights[f"{name}.weight"], weights[f"{name}.bias"]] for name in LAYERS]
write_perceptron(sys.argv[2], layers, 5, NAME, KEYWORDS)  # five means; the rest are deviations
