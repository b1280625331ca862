"""Proximal policy optimization in plain torch, written from the papers.

- Advantages: Schulman et al., *High-Dimensional Continuous Control Using Generalized Advantage Estimation*, 2016.
- Updates: Schulman et al., *Proximal Policy Optimization Algorithms*, 2017.
- Several agents: Yu et al., *The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games*, 2022.
- Optimizer: Kingma and Ba, *Adam: A Method for Stochastic Optimization*, 2015.

Shapes: B environments, T steps, U advantages per step (one per agent, or one for the team). Steps after an agent
has left are not `active` and count in no mean.
"""

import math

import torch
from torch.nn.functional import smooth_l1_loss


def generalized_advantages(reward, value, next_value, done, terminated, gamma, lmbda):
    """Return advantages (B, T, U): sums stop at `done`; after `terminated` the next value is 0."""
    delta = reward + gamma * next_value * ~terminated - value
    advantage, running = torch.empty_like(delta), torch.zeros_like(delta[:, 0])
    for t in reversed(range(delta.shape[1])):
        running = delta[:, t] + gamma * lmbda * ~done[:, t] * running
        advantage[:, t] = running
    return advantage


def normalized(advantage, active, correction):
    """Return advantages (..., U) with mean 0 and deviation 1 over the active steps of each unit."""
    columns = zip(advantage.unbind(-1), active.unbind(-1), strict=True)
    return torch.stack([(unit - unit[on].mean()) / unit[on].std(correction=correction) for unit, on in columns], -1)


def categorical(action, logits):
    """Return the log-probability and entropy (..., N) of actions (..., N) under logits (..., N, A)."""
    log_probs = logits - logits.logsumexp(-1, keepdim=True)
    chosen = log_probs.gather(-1, action.unsqueeze(-1)).squeeze(-1)
    return chosen, -(log_probs.exp() * log_probs).sum(-1)


def normal(action, mean, deviation):
    """Return the log-density and entropy (..., N) of rows (..., N, A) under independent normal distributions."""
    constant = 0.5 * math.log(2 * math.pi)
    log_density = -(((action - mean) / deviation) ** 2) / 2 - deviation.log() - constant
    return log_density.sum(-1), (0.5 + constant + deviation.log()).sum(-1)


def recurrent_distribution(network, observation, memory, is_init):
    """Return the distribution's parameters (R, T, ...) of R sequences; the GRU runs step by step."""
    embedding = network.actor.encoder(*observation)
    gru, states, state = network.core.gru.gru, [], memory[:, 0]  # (R, M, size)
    for t in range(embedding.shape[1]):
        state = torch.where(is_init[:, t, :, None], 0.0, state)
        inputs = embedding[:, t].reshape(-1, gru.input_size)
        weights = gru.weight_ih_l0, gru.weight_hh_l0, gru.bias_ih_l0, gru.bias_hh_l0
        state = torch.gru_cell(inputs, state.reshape(-1, gru.hidden_size), *weights).reshape(state.shape)
        states.append(state.reshape(*embedding[:, t].shape[:-1], -1))
    return network.actor.act(torch.stack(states, 1))


class ReferencePPO:
    """Updates an actor and a critic; the settings are those of a `TrainConfig`."""

    def __init__(self, distribution, log_prob_and_entropy, critic, weights, config, masked=False):
        """Begin with Adam's moments at 0.

        Args:
            distribution: function of minibatch rows to the parameters of the action distribution.
            log_prob_and_entropy: function of actions and those parameters, each result (..., U).
            critic: function of observations to values (..., U).
            weights: tensors to optimize.
            config: a `TrainConfig`.
            masked: whether steps may be inactive.
        """
        self.distribution, self.log_prob_and_entropy, self.critic = distribution, log_prob_and_entropy, critic
        self.weights, self.masked = weights, masked
        self.ppo, self.optimization = config.ppo, config.optimization
        self.moments = [(torch.zeros_like(weight), torch.zeros_like(weight)) for weight in weights]
        self.num_steps = 0
        self.ratios = []

    def update(self, batch, by_sequence, progress):
        """Optimize on a batch (B, T, ...); minibatch rows are single steps, or whole sequences if `by_sequence`."""
        ppo, optimization, annealing = self.ppo, self.optimization, 1 - 0.9 * progress
        with torch.no_grad():
            value, next_value = self.critic(batch["observation"]), self.critic(batch["next_observation"])
            signals = batch["reward"], value, next_value, batch["done"], batch["terminated"]
            advantage = generalized_advantages(*signals, ppo.gamma, ppo.lmbda)
        rows = {**batch, "advantage": advantage, "target": advantage + value}
        if not by_sequence:
            rows = _select(rows, lambda tensor: tensor.flatten(0, 1))
        size = optimization.minibatch_size // (optimization.steps_per_batch if by_sequence else 1)
        for _ in range(optimization.num_epochs):
            for index in torch.randperm(len(rows["advantage"])).split(size):
                part = _select(rows, lambda tensor, index=index: tensor[index])
                self._descend(self._loss(part, ppo.entropy_coeff * annealing), optimization.learning_rate * annealing)

    def _loss(self, part, entropy_coeff):
        ppo = self.ppo
        log_prob, entropy = self.log_prob_and_entropy(part["action"], *self.distribution(part))
        # The papers do not say which deviation: TorchRL takes the sample's, and with a mask the population's.
        active, correction = part["active"], 1 - self.masked
        advantage = normalized(part["advantage"], active, correction)
        ratio = (log_prob - part["log_prob"]).exp()
        self.ratios.append(ratio.detach())
        clipped = ratio.clamp(1 - ppo.clip_epsilon, 1 + ppo.clip_epsilon)
        gain = torch.minimum(ratio * advantage, clipped * advantage)[active].mean()
        value_loss = smooth_l1_loss(self.critic(part["observation"])[active], part["target"][active])
        return -gain + ppo.critic_coeff * value_loss - entropy_coeff * entropy[active].mean()

    def _descend(self, loss, learning_rate, beta1=0.9, beta2=0.999, eps=1e-5):
        gradients = torch.autograd.grad(loss, self.weights)
        norm = torch.cat([gradient.flatten() for gradient in gradients]).norm()
        scale = (self.optimization.max_grad_norm / norm).clamp(max=1)
        self.num_steps += 1
        with torch.no_grad():
            for weight, gradient, (first, second) in zip(self.weights, gradients, self.moments, strict=True):
                first.mul_(beta1).add_((1 - beta1) * scale * gradient)
                second.mul_(beta2).add_((1 - beta2) * (scale * gradient) ** 2)
                mean, square = first / (1 - beta1**self.num_steps), second / (1 - beta2**self.num_steps)
                weight.sub_(learning_rate * mean / (square.sqrt() + eps))


def _select(rows, function):
    return {
        name: tuple(map(function, part)) if isinstance(part, tuple) else function(part) for name, part in rows.items()
    }
