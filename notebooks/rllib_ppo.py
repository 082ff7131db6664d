"""PPO of RLlib on radar tracking: ``python rllib_ppo.py STEPS POLICY.npz``, to be contested."""

import sys

import numpy as np
from kfenv.agents.contestants.policy import write_perceptron
from kfenv.agents.learning.rllib import WorkerStreams
from ray.rllib.algorithms.ppo import PPOConfig

NAME, KEYWORDS = "kfenv/RadarTracking-v0", {"rate": 2.0, "reward": "log-rmse"}
NETWORK = {"fcnet_hiddens": [64, 64], "fcnet_activation": "tanh", "free_log_std": True}
LAYERS = ("encoder.actor_encoder.net.mlp.0", "encoder.actor_encoder.net.mlp.2", "pi.net.mlp.0")

config = PPOConfig().environment(f"kfenv:{NAME}", env_config=KEYWORDS | {"info": "none"})
config.env_runners(num_env_runners=1, num_envs_per_env_runner=256, rollout_fragment_length=128,
                   gym_env_vectorize_mode="vector_entry_point", sample_timeout_s=600)  # fmt: skip
config.training(train_batch_size=32768, minibatch_size=8192, num_epochs=4, lr=2e-3, gamma=0.95,
                lambda_=0.95, use_kl_loss=False, clip_param=0.2, grad_clip=0.5)  # fmt: skip
config.rl_module(model_config=NETWORK)
config.callbacks(on_environment_created=WorkerStreams(seed=0)).debugging(seed=None)
algorithm, steps = config.build_algo(), 0
# Deviations begin at 0.37: at one, RLlib's own start, a track is lost before anything is learnt.
new = algorithm.get_module().get_state() | {"pi.log_std": np.full(5, -1.0, np.float32)}
algorithm.set_state({"learner_group": {"learner": {"rl_module": {"default_policy": new}}}})
while steps < int(sys.argv[1]):
    steps = algorithm.train()["num_env_steps_sampled_lifetime"]
    print(f"{steps:.0f} steps", flush=True)
weights = algorithm.get_module().get_state()
layers = [[weights[f"{name}.weight"], weights[f"{name}.bias"]] for name in LAYERS]
write_perceptron(sys.argv[2], layers, 5, NAME, KEYWORDS)
