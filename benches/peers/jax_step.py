"""The training step in JAX: forward, backward and AdamW of the same head, compiled by XLA."""

import jax
import jax.numpy as jnp

import problem


class Step:
    """One optimiser step on a batch in memory."""

    def __init__(self, mode, conditions, samples, device):
        self.mode = mode
        jax.config.update("jax_default_device", jax.devices(device)[0])
        self.weights = {name: jnp.asarray(value) for name, value in problem.initial_weights(mode).items()}
        zeros = lambda: {name: jnp.zeros_like(value) for name, value in self.weights.items()}
        self.state = (jnp.zeros(()), zeros(), zeros())
        self.batch = tuple(jnp.asarray(array) for array in problem.batch(conditions, samples))
        self.update = jax.jit(self.step)

    def network(self, weights, part, seen, features):
        weight, bias = weights[part + "0.weight"], weights[part + "0.bias"]
        length = seen.shape[1]
        hidden = (seen @ weight[:, :length].T + bias)[:, None, :]
        if features is not None:
            hidden = hidden + features @ weight[:, length:].T
        for index in (1, 2):
            hidden = jax.nn.leaky_relu(hidden, problem.LEAKY)
            hidden = hidden @ weights[f"{part}{index}.weight"].T + weights[f"{part}{index}.bias"]
        return hidden

    def loss(self, weights, c, y, target):
        latent = c
        for index in (0, 1):
            latent = latent @ weights[f"encoder{index}.weight"].T + weights[f"encoder{index}.bias"]
            latent = jax.nn.leaky_relu(latent, problem.LEAKY)
        seen = jnp.concatenate([c, latent], 1)
        u, v = y[..., 0], y[..., 1]
        if self.mode == "coupled":
            features = jnp.stack([jnp.cos(2 * jnp.pi * u), jnp.sin(2 * jnp.pi * u)], -1)
            elevation, log_v = spline(self.network(weights, "elevation", seen, features), v, circle=False)
        else:
            logits = self.network(weights, "elevation", seen, None)
            logits = jnp.broadcast_to(logits, (*v.shape, problem.LOGITS))
            _, log_v = spline(logits, v, circle=False)
            elevation = v
        _, log_u = spline(self.network(weights, "azimuth", seen, elevation[..., None]), u, circle=True)
        log_w = jnp.log(target) - jnp.log(target.sum(1, keepdims=True))
        return jax.nn.logsumexp(log_w + jnp.log(target) - log_u - log_v, 1).mean()

    def step(self, weights, state, c, y, target):
        loss, gradients = jax.value_and_grad(self.loss)(weights, c, y, target)
        count, first, second = state
        count = count + 1
        beta_1, beta_2 = problem.BETAS
        first = {name: beta_1 * first[name] + (1 - beta_1) * gradients[name] for name in weights}
        second = {name: beta_2 * second[name] + (1 - beta_2) * gradients[name] ** 2 for name in weights}
        rate = problem.LEARNING_RATE

        def move(name):
            mean, square = first[name] / (1 - beta_1**count), second[name] / (1 - beta_2**count)
            decayed = weights[name] * (1 - rate * problem.WEIGHT_DECAY)
            return decayed - rate * mean / (jnp.sqrt(square) + problem.EPSILON)

        return {name: move(name) for name in weights}, (count, first, second), loss

    def __call__(self):
        self.weights, self.state, loss = self.update(self.weights, self.state, *self.batch)
        return loss


def spline(logits, x, circle):
    """Evaluates a rational-quadratic spline in the density direction: value and log-slope."""
    bins = problem.BINS
    free = 1.0 - bins * problem.MIN_BIN
    widths = problem.MIN_BIN + free * jax.nn.softmax(logits[..., :bins], -1)
    heights = problem.MIN_BIN + free * jax.nn.softmax(logits[..., bins : 2 * bins], -1)
    if circle:
        x = jnp.mod(x + logits[..., 3 * bins], 1.0)
        slopes = jnp.concatenate([logits[..., 2 * bins : 3 * bins], logits[..., 2 * bins : 2 * bins + 1]], -1)
    else:
        slopes = logits[..., 2 * bins :]
    rights, tops = jnp.cumsum(widths, -1), jnp.cumsum(heights, -1)
    index = (x[..., None] >= rights[..., :-1]).sum(-1, keepdims=True)
    pick = lambda values, at: jnp.take_along_axis(values, at, -1)[..., 0]
    width, height = pick(widths, index), pick(heights, index)
    left, bottom = pick(rights, index) - width, pick(tops, index) - height
    d0 = problem.MIN_SLOPE + jax.nn.softplus(pick(slopes, index) + problem.SLOPE_OFFSET)
    d1 = problem.MIN_SLOPE + jax.nn.softplus(pick(slopes, index + 1) + problem.SLOPE_OFFSET)
    t = jnp.clip((x - left) / width, 0.0, 1.0)
    o, s = 1.0 - t, height / width
    n = d1 * t * t + 2.0 * s * t * o + d0 * o * o
    d = s * (1.0 - 2.0 * t * o) + (d0 + d1) * t * o
    return bottom + height * (s * t + d0 * o) * t / d, 2.0 * jnp.log(s) + jnp.log(n) - 2.0 * jnp.log(d)
