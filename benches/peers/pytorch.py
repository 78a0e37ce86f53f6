"""The training step in PyTorch: forward, backward and AdamW of the same head, eager or compiled."""

import math
import os

import torch
import torch.nn.functional as F

import problem


def name_of(device):
    """Names the hardware."""
    return torch.cuda.get_device_name() if device == "cuda" else f"{os.cpu_count()} cores"


class Step:
    """One optimiser step on a batch in memory, on the device `cpu` or `cuda`: there with TF32 and, compiled, CUDA graphs."""

    def __init__(self, mode, conditions, samples, device, compiled):
        self.mode = mode
        weights = problem.initial_weights(mode)
        self.weights = {name: torch.tensor(value, device=device, requires_grad=True) for name, value in weights.items()}
        fast = {}
        if device == "cuda":
            torch.set_float32_matmul_precision("high")
            fast = {"mode": "reduce-overhead"}
        self.optimizer = torch.optim.AdamW(
            self.weights.values(), lr=problem.LEARNING_RATE, betas=problem.BETAS, eps=problem.EPSILON,
            weight_decay=problem.WEIGHT_DECAY, fused=True,
        )
        self.batch = tuple(torch.tensor(array, device=device) for array in problem.batch(conditions, samples))
        self.loss = torch.compile(self.forward, dynamic=False, **fast) if compiled else self.forward

    def linear(self, name, x):
        return F.linear(x, self.weights[name + ".weight"], self.weights[name + ".bias"])

    def network(self, part, seen, features):
        """Returns logits [C, S or 1, 97]; the condition's part of the first layer is computed once per
        condition."""
        weight, bias = self.weights[part + "0.weight"], self.weights[part + "0.bias"]
        length = seen.shape[1]
        hidden = F.linear(seen, weight[:, :length], bias)[:, None, :]
        if features is not None:
            hidden = hidden + F.linear(features, weight[:, length:])
        hidden = F.leaky_relu(hidden, problem.LEAKY)
        hidden = F.leaky_relu(self.linear(part + "1", hidden), problem.LEAKY)
        return self.linear(part + "2", hidden)

    def log_density(self, c, y):
        """Returns ln q(y | c), [C, S]."""
        latent = F.leaky_relu(self.linear("encoder0", c), problem.LEAKY)
        latent = F.leaky_relu(self.linear("encoder1", latent), problem.LEAKY)
        seen = torch.cat([c, latent], 1)
        u, v = y[..., 0], y[..., 1]
        if self.mode == "coupled":
            features = torch.stack([torch.cos(2 * math.pi * u), torch.sin(2 * math.pi * u)], -1)
            elevation, log_v = spline(self.network("elevation", seen, features), v, circle=False)
        else:
            logits = self.network("elevation", seen, None)
            _, log_v = spline(logits.expand(-1, v.shape[1], -1), v, circle=False)
            elevation = v
        _, log_u = spline(self.network("azimuth", seen, elevation[..., None]), u, circle=True)
        return log_u + log_v

    def forward(self, c, y, target):
        log_q = self.log_density(c, y)
        # log-chi-square: log sum_i w_i g_i / q_i, the same in all peers.
        log_w = torch.log(target) - torch.log(target.sum(1, keepdim=True))
        return torch.logsumexp(log_w + torch.log(target) - log_q, 1).mean()

    def __call__(self):
        self.optimizer.zero_grad(set_to_none=True)
        loss = self.loss(*self.batch)
        loss.backward()
        self.optimizer.step()
        return loss.detach()


def spline(logits, x, circle):
    """Evaluates a rational-quadratic spline in the density direction: value and log-slope."""
    bins = problem.BINS
    free = 1.0 - bins * problem.MIN_BIN
    widths = problem.MIN_BIN + free * torch.softmax(logits[..., :bins], -1)
    heights = problem.MIN_BIN + free * torch.softmax(logits[..., bins : 2 * bins], -1)
    if circle:
        x = torch.remainder(x + logits[..., 3 * bins], 1.0)
        slopes = torch.cat([logits[..., 2 * bins : 3 * bins], logits[..., 2 * bins : 2 * bins + 1]], -1)
    else:
        slopes = logits[..., 2 * bins :]
    rights, tops = torch.cumsum(widths, -1), torch.cumsum(heights, -1)
    index = (x[..., None] >= rights[..., :-1]).sum(-1, keepdim=True)
    pick = lambda values: torch.gather(values, -1, index).squeeze(-1)
    width, height = pick(widths), pick(heights)
    left, bottom = pick(rights) - width, pick(tops) - height
    d0 = problem.MIN_SLOPE + F.softplus(pick(slopes) + problem.SLOPE_OFFSET)
    d1 = problem.MIN_SLOPE + F.softplus(torch.gather(slopes, -1, index + 1).squeeze(-1) + problem.SLOPE_OFFSET)
    t = ((x - left) / width).clamp(0.0, 1.0)
    o, s = 1.0 - t, height / width
    n = d1 * t * t + 2.0 * s * t * o + d0 * o * o
    d = s * (1.0 - 2.0 * t * o) + (d0 + d1) * t * o
    return bottom + height * (s * t + d0 * o) * t / d, 2.0 * torch.log(s) + torch.log(n) - 2.0 * torch.log(d)
