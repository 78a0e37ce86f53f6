"""Reflected light of a surface, by samples; a comparison of samplers; a trained head."""

import numpy as np

import headtail

# A map: a built-in one, a .hdr or .exr file, or an array [height, width, 3] of linear radiance.
env = headtail.Environment("studio")
sampler = headtail.Sampler.from_spec("patches", env)

# One direction for each row: here 100,000 for one white diffuse surface that faces up.
n = np.array([0, 1, 0], np.float32)
draws = sampler.sample(n, count=100_000, seed=1)
drawn = draws.pdf > 0
weights = np.maximum(draws.wi[drawn] @ n, 0) / np.pi / draws.pdf[drawn]
print("reflected", (draws.radiance[drawn] * weights[:, None]).sum(0) / len(draws.pdf))

# Glossy surfaces have a width and a direction to the viewer; pdf() is for MIS with samplers of your own. Prepared
# points make both cheaper; Sampler.sample and Sampler.pdf take the same arguments.
wo = np.array([0.6, 0.8, 0], np.float32)
points = sampler.prepare(n, wo, alpha=0.3, count=4)
glossy = points.sample(seed=2)
print("pdfs", points.pdf(glossy.wi), glossy.pdf)

# Renderings and comparisons are arrays.
table, _ = headtail.compare("sphere", env, ["mis", "patches"], spp=(4,), runs=2, reference_spp=128, width=64, height=48)
for name in ("mis", "patches"):
    print(name, "MSE", table["mse"][table["sampler"] == name].mean())

# A head is trained, saved and opened again. Ctrl-C ends training; checkpoint_dir and resume go on with it.
if hasattr(headtail, "fit"):
    head = headtail.fit(env, "lambert", steps=30, progress=lambda now: None)
    print(head.info["training"]["relative_variance"])
