"""PPO in PyTorch against the zoo's training partners, in one file: python ppo_torch.py --help."""

import argparse
import time

import torch
from torch import nn
from torch.distributions import Normal

import assistax_zoo as az


class Agent(nn.Module):
    """Actor and critic, with running statistics of the observations."""

    def __init__(self, obs: int, actions: int) -> None:
        super().__init__()
        self.actor, self.critic = mlp(obs, actions), mlp(obs, 1)
        self.log_std = nn.Parameter(torch.full((actions,), -1.2))
        for name, value in (("mean", 0.0), ("square", 1.0), ("count", 1e-4)):
            self.register_buffer(name, torch.full((obs,), value))

    def see(self, obs: torch.Tensor) -> None:
        self.count += len(obs)
        self.mean += (obs - self.mean).sum(0) / self.count
        self.square += (obs**2 - self.square).sum(0) / self.count

    def forward(self, obs: torch.Tensor) -> tuple[Normal, torch.Tensor]:
        scale = (self.square - self.mean**2).clamp(min=1e-6).sqrt()
        obs = ((obs - self.mean) / scale).clamp(-10, 10)
        return Normal(self.actor(obs), self.log_std.exp()), self.critic(obs)[..., 0]


def mlp(inputs: int, outputs: int) -> nn.Sequential:
    last = nn.Linear(128, outputs)
    nn.init.orthogonal_(last.weight, 0.01 if outputs > 1 else 1.0)
    return nn.Sequential(nn.Linear(inputs, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), last)


def train(task: str, partners: str | None, envs: int, steps: int, rollout: int = 32) -> Agent:
    env = az.vector_env(task, envs, partners=partners, arrays="jax")
    agent = Agent(env.single_observation_space.shape[0], env.single_action_space.shape[0])
    adam, returns = torch.optim.Adam(agent.parameters(), lr=1e-3), []
    obs = torch.from_dlpack(env.reset(seed=0)[0])
    began, earned, updates = time.time(), torch.zeros(envs), steps // (envs * rollout)
    for update in range(updates):
        adam.param_groups[0]["lr"] = 1e-3 * (1 - update / updates)
        rows = []
        with torch.no_grad():
            for _ in range(rollout):
                agent.see(obs)
                policy, value = agent(obs)
                action = policy.sample()
                *step, info = env.step(action)
                new, reward, stop, limit = map(torch.from_dlpack, step)
                after = torch.from_dlpack(info["final_obs"]) if "final_obs" in info else new
                rows.append((obs, action, policy.log_prob(action).sum(-1), value,
                             reward, agent(after)[1] * ~stop, stop | limit))  # fmt: skip
                obs, earned = new, earned + reward
                earned, returns = earned * ~(stop | limit), returns + earned[stop | limit].tolist()
                if limit[0]:  # of all at once; the value of what comes next still counts
                    mean = torch.tensor(returns[-envs:]).mean()
                    print(f"{time.time() - began:.0f} s, return {mean:.1f}", flush=True)
            seen, taken, log, worth, paid, then, end = map(torch.stack, zip(*rows, strict=True))
            gains, gain = torch.zeros_like(worth), torch.zeros(envs)
            for t in reversed(range(rollout)):
                delta = paid[t] + 0.99 * then[t] - worth[t]
                gain = gains[t] = delta + 0.99 * 0.95 * gain * ~end[t]
        batch = [x.flatten(0, 1) for x in (seen, taken, log, gains, gains + worth)]
        for part in (p for _ in range(4) for p in torch.randperm(envs * rollout).chunk(4)):
            o, a, old, gain, target = (x[part] for x in batch)
            policy, value = agent(o)
            ratio = (policy.log_prob(a).sum(-1) - old).exp()
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            loss = -torch.min(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
            loss = loss + 0.5 * ((value - target) ** 2).mean() - 1e-3 * policy.entropy().mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            adam.step()
    return agent


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="gentle_scratch")
    parser.add_argument("--partners", help="teams of the training side, or persons; default all")
    parser.add_argument("--envs", type=int, default=512)
    parser.add_argument("--steps", type=int, default=6_000_000)
    parser.add_argument("--out", default="agent.pt")
    args = parser.parse_args()
    torch.set_num_threads(1)  # the simulations have the other cores
    torch.manual_seed(0)
    torch.save(train(args.task, args.partners, args.envs, args.steps), args.out)
