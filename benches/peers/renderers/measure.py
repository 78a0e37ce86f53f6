"""Variance, means and ratios of renderings.

The MSE of an unbiased renderer equals its variance, so no converged reference is needed. The variance of each
pixel is estimated from independent runs. Images are compared by sums over
blocks of pixels, which also give the intervals."""

import numpy as np

BLOCK = 16
# Renderers agree if the means of their pictures differ by at most this fraction plus three standard errors
# ...
MEAN_TOLERANCE = 0.005
# ... and the means of blocks by this fraction of the picture's mean, as a root mean square beyond three
# standard errors.
BLOCK_TOLERANCE = 0.03
RESAMPLINGS = 2000


def interior(coverage):
    """Returns pixels whose neighbours are also covered, so that no silhouette passes through them."""
    padded = np.pad(coverage, 1, mode="edge")
    height, width = coverage.shape
    shifted = [padded[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.logical_and.reduce(shifted)


def block_sums(values, mask):
    """Returns sums of [height, width] values over blocks, for pixels in the mask."""
    height, width = values.shape
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    padded = np.zeros((rows * BLOCK, columns * BLOCK))
    padded[:height, :width] = np.where(mask, values, 0.0)
    return padded.reshape(rows, BLOCK, columns, BLOCK).sum((1, 3)).ravel()


def summary(images, mask):
    """Returns variance and mean of pixels in the mask over all channels, with the sums of blocks."""
    images = np.array(images)
    variance = block_sums(images.var(0, ddof=1).mean(-1), mask)
    sums = np.array([block_sums(image.mean(-1), mask) for image in images])
    pixels = mask.sum()
    mean, errors = sums.mean(0), sums.std(0, ddof=1) / np.sqrt(len(images))
    return {
        "variance": variance.sum() / pixels,
        "mean": mean.sum() / pixels,
        "mean_error": sums.sum(1).std(ddof=1) / np.sqrt(len(images)) / pixels,
        "blocks": {"variance": rounded(variance), "sum": rounded(mean, 8), "error": rounded(errors)},
    }


def rounded(values, digits=4):
    return [float(f"{value:.{digits}g}") for value in values]


def difference(own, other):
    """Returns (relative difference of means, its standard error, relative difference of blocks beyond noise)
    of two rows."""
    relative = own["mean"] / other["mean"] - 1
    error = np.hypot(own["mean_error"] / own["mean"], other["mean_error"] / other["mean"])
    a, b = own["blocks"], other["blocks"]
    noise = np.square(a["error"]) + np.square(b["error"])
    excess = np.sum(np.square(np.subtract(a["sum"], b["sum"])) - noise)
    # Squares of normal variables deviate from their expectation by sqrt(2), as do variances from few runs.
    excess -= 3 * np.sqrt((2 + 2 / (own["runs"] - 1)) * np.sum(np.square(noise)))
    blocks = np.sqrt(max(excess, 0) * len(noise)) / np.sum(b["sum"])
    return relative, error, blocks


def agree(own, other):
    relative, error, blocks = difference(own, other)
    return bool(abs(relative) <= MEAN_TOLERANCE + 3 * error and blocks <= BLOCK_TOLERANCE)


def at_budget(row):
    """Returns the factor from the variance of a row to that at its budget: variance is inverse to time."""
    return row["seconds"] / row["budget"]


def ratio(baseline, row):
    """Returns the variance of a baseline over that of a row at equal time, with a 95 % interval from
    resampled blocks."""
    factor = at_budget(baseline) / at_budget(row)
    above, below = np.array(baseline["blocks"]["variance"]), np.array(row["blocks"]["variance"])
    drawn = np.random.default_rng(0).integers(0, len(above), (RESAMPLINGS, len(above)))
    ratios = factor * above[drawn].sum(1) / below[drawn].sum(1)
    low, high = np.quantile(ratios, [0.025, 0.975])
    return float(factor * above.sum() / below.sum()), float(low), float(high)


def samples_for(renderer, budget, start, log):
    """Returns the samples per pixel that take about a budget without preparation; its test renderings are
    discarded."""
    samples = start
    for _ in range(5):
        renderer.render(samples, 1)  # compiles kernels for this size
        _, seconds, preparation = renderer.render(samples, 2)
        wanted = samples * budget / max(seconds - preparation, 1e-4)
        log(f"  {samples} samples: {seconds:.3f} s, {preparation:.3f} s of preparation")
        if abs(wanted / samples - 1) < 0.1 or wanted < 1 and samples == 1:
            break
        samples = max(1, round(min(wanted, 16 * samples)))
    return samples
