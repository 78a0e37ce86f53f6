"""The density of `patches`, from docs/method/patches.md alone: `Patches(map).pdf(n, wo, wi, alpha)`.

Short and slow, in double precision, with numpy. It evaluates the density without sampling."""

import heapq

import numpy as np

CLUSTERS, PARTS, NARROW = 32, 16, 0.3


def directions(u, v):
    """Returns unit directions of points of the map: u from 0 to 1 around, v from 0 (up) to 1 (down)."""
    phi, theta = 2 * np.pi * u, np.pi * v
    return np.stack([np.sin(phi) * np.sin(theta), np.cos(theta) + 0 * u, -np.cos(phi) * np.sin(theta)], -1)


class Light:
    """Points of the map with their fractions of its light, and sums over rectangles (node = column, row,
    width, height)."""

    def __init__(self, radiance):
        height, width = radiance.shape[:2]
        self.columns, self.rows = width, height - 1
        step = np.pi / self.rows
        # The sine over a row of texels, averaged with the weight of a bilinear filter.
        sines = np.sin(np.arange(height) * step) * (2 - 2 * np.cos(step)) / step**2
        sines[[0, -1]] = 2 * (1 - np.sin(step) / step) / step
        nodes = radiance @ [0.2126, 0.7152, 0.0722] * sines[:, None]
        nodes = nodes / ((nodes[:-1] + nodes[1:]).mean() / 2)
        self.nodes = np.concatenate([nodes, nodes[:, :1]], 1)
        k = self.side = max(-(-128 // max(min(self.rows, -(-width // 2)), 1)), 1)
        self.step = max(np.pi / self.rows, 2 * np.pi / width) / k
        t = (np.arange(k) + 0.5) / k
        across, down = (np.arange(width)[:, None] + t).ravel(), (np.arange(self.rows)[:, None] + t).ravel()
        v, u = np.meshgrid(down, across, indexing="ij")
        self.energy = self.density((u + 0.5) / width, v / self.rows) / u.size
        self.w = directions((u + 0.5) / width, v / self.rows)
        spread = self.step**2 / 12
        outer = (1 - spread) * self.w[..., :, None] * self.w[..., None, :] + spread * np.eye(3)
        sine = np.sqrt(np.maximum(1 - self.w[..., 1] ** 2, 1e-14))
        bright = self.energy * u.size / (2 * np.pi**2 * sine)
        e = self.energy[..., None]
        parts = np.concatenate([e, e * self.w, e * outer.reshape(*u.shape, 9), e * bright[..., None]], -1)
        self.sums = np.zeros((u.shape[0] + 1, u.shape[1] + 1, 14))
        self.sums[1:, 1:] = parts.cumsum(0).cumsum(1)
        bits = lambda count: 1 << (count - 1).bit_length()
        self.root = (0, 0, bits(width), bits(self.rows))

    def density(self, u, v):
        """Returns the density of light x sine over the map, bilinear between texels."""
        x, y = (u * self.columns - 0.5) % self.columns, np.clip(v * self.rows, 0, self.rows)
        i, j = np.minimum(x.astype(int), self.columns - 1), np.minimum(y.astype(int), self.rows - 1)
        s, t = x - i, y - j
        upper = (1 - s) * self.nodes[j, i] + s * self.nodes[j, i + 1]
        return (1 - t) * upper + t * ((1 - s) * self.nodes[j + 1, i] + s * self.nodes[j + 1, i + 1])

    def ends(self, node):
        column, row, width, height = node
        ends = np.array([column, column + width, row, row + height])
        return np.minimum(ends, [self.columns, self.columns, self.rows, self.rows]) * self.side

    def moments(self, node):
        left, right, top, bottom = self.ends(node)
        total = self.sums[bottom, right] - self.sums[top, right] - self.sums[bottom, left] + self.sums[top, left]
        return total if self.energy[top:bottom, left:right].any() else 0 * total

    def points(self, node):
        left, right, top, bottom = self.ends(node)
        return self.w[top:bottom, left:right][self.energy[top:bottom, left:right] > 0]


def halves(node):
    column, row, width, height = node
    if width > height:
        return [(column, row, width // 2, height), (column + width // 2, row, width // 2, height)]
    return [(column, row, width, height // 2), (column, row + height // 2, width, height // 2)]


def covariance(m):
    s = m[1:4] / m[0]
    return m[4:13].reshape(3, 3) / m[0] - np.outer(s, s)


class Patches:
    """The patches of a map [height, width, 3] of linear radiance."""

    def __init__(self, radiance):
        self.light = Light(np.asarray(radiance, float))
        k = np.arange(96) + 0.5
        z, turn = 1 - k / 48, (k - 0.5) * 2.399963229728653
        ring = np.sqrt(1 - z * z)
        self.normals = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], -1)
        self.irradiance = np.maximum(self.cosines(self.light.root, 11)[0], 1e-9)
        self.clusters = self.divide(self.light.root, CLUSTERS, self.gain)
        # Each with its parts, and these with theirs.
        self.leaves = [self.divide(c, PARTS, self.gain) for c in self.clusters]
        self.twigs = [[self.divide(leaf, PARTS, self.spread) for leaf in leaves] for leaves in self.leaves]
        self.small = np.array([self.is_small(c) for c in self.clusters])
        if self.small.all():
            self.small[:] = False

    def cosines(self, node, levels):
        """Returns a node's light on each normal, and the same with squared cosines."""
        nodes = [node]
        for _ in range(levels):
            nodes = [half for n in nodes for half in (halves(n) if n[2] * n[3] > 1 else [n])]
        m = np.array([m for m in map(self.light.moments, nodes) if m[0] > 0])
        cosine = np.maximum(m[:, 1:4] / m[:, :1] @ self.normals.T, 0)
        return m[:, 0] @ cosine, m[:, 0] @ cosine**2

    def gain(self, node):
        first, second = self.cosines(node, 8)
        excess = np.sqrt(self.light.moments(node)[0] * second) - first
        return (np.maximum(excess, 0) / self.irradiance).sum()

    def spread(self, node):
        m = self.light.moments(node)
        return m[0] * np.trace(covariance(m))

    def divide(self, start, count, gain):
        """Selects the best `count` nodes by a gain, greedily."""
        entry = lambda node: (-gain(node) if node[2] * node[3] > 1 else 0.0, node)
        heap = [entry(start)]
        while len(heap) < count and heap[0][0] < 0:
            _, node = heapq.heappop(heap)
            for half in halves(node):
                if self.light.moments(half)[0] > 0:
                    heapq.heappush(heap, entry(half))
        return [node for _, node in heap]

    def is_small(self, cluster):
        variance = lambda node: np.trace(covariance(self.light.moments(node)))
        core, least = cluster, self.light.moments(cluster)[0] / 2
        while core[2] * core[3] > 1:
            brighter = [half for half in halves(core) if self.light.moments(half)[0] > least]
            if not brighter:
                break
            core = brighter[0]
        return variance(cluster) < 1e-3 or (variance(cluster) < 2e-3 and variance(core) < 2e-4)

    def mass(self, node, n, wo, alpha, leaf):
        """Returns a node's light reflected by a surface, up to a factor."""
        m, points = self.light.moments(node), self.light.points(node)
        s, three = m[1:4] / m[0], 3 * covariance(m)
        d = points - s
        cell = 0.8 * self.light.step
        stretch = np.sqrt(np.einsum("ki,ij,kj->k", d, np.linalg.inv(three + 3e-7 * np.eye(3)), d).max())
        mean, a = n @ s, np.sqrt(max(n @ three @ n, 0) + 3e-7)
        bound = mean + min(1.001 * stretch * a + cell, np.sqrt((d * d).sum(1).max()) + cell)
        if bound <= 0:
            return 0.0
        if alpha is None:
            above = max(mean + a, 0)
            if leaf:
                value = np.sqrt(mean**2 + a**2 / 3 if mean > a else above**3 / (6 * a))
            else:
                value = mean if mean > a else above**2 / (4 * a)
            return m[0] * max(value, (0.15 if leaf else 0.045) * bound)
        top, bottom = max(min(mean + a, bound), 0.2 * bound), max(mean - a, 0)
        visible = max(min((top - bottom) / (2 * a), 1), 0.02)
        w = s + (0.5 * (top + bottom) - mean) * n
        scale = 1 / np.sqrt(max(w @ w, 1e-6))
        w, cos_i, cos_o = w * scale, np.clip(0.5 * (top + bottom) * scale, 1e-4, 1), max(n @ wo, 1e-4)
        cos = min(wo @ w, 1 - 1e-6)
        half = max(0.5 + 0.5 * cos, 1e-3)
        # 1 / cos^2 of half the angle, and 1 / sin^2 of the full angle.
        per_half, per_sine = 1 / half, 0.5 / (half * (1 - cos))
        cos_h = min((cos_i + cos_o) ** 2 / (4 * half), 1)
        across = np.cross(wo, w)
        var_across = max(across @ three @ across, 0) / 3 * per_sine
        var_along = max(np.trace(three) / 3 - var_across, 0)
        tilt = (n @ across) ** 2 * per_sine
        along = min(alpha**2 + 0.5 * var_along, 1)
        over = min(alpha**2 + 0.5 * var_across * per_half, 1)
        scaled = cos_h * along * over + max(1 - cos_h - tilt, 0) * over + tilt * along
        smooth, rough = 2 * cos_i * cos_o, cos_i + cos_o
        shadowing = 2 * (smooth + alpha * (rough - smooth))
        fraction = np.sqrt(visible) if leaf else visible
        return m[0] * fraction * (along * over) ** 1.5 * cos_i / (np.pi * scaled**2 * shadowing)

    def cluster_probabilities(self, n, wo, alpha):
        """Returns the probabilities of clusters, and the mixture weight beside BRDF sampling."""
        masses = np.array([self.mass(c, n, wo, alpha, leaf=False) for c in self.clusters])
        mixture_weight = 1.0
        if alpha is not None and masses.sum() > 0:
            m = np.array([self.light.moments(c) for c in self.clusters])
            unevenness = np.clip((masses @ (m[:, 13] / m[:, 0])) / masses.sum() ** 2, 0.1, 1e6)
            odds = np.exp(-4.35 - 2.14 * np.log(alpha) - 1.92 * np.log(unevenness))
            by_width = np.clip(0.5 * (0.05 / alpha) ** 1.25, 0.03, 0.9)
            least = min(0.02 * max(0.1 / alpha, 1) ** 3, 0.5)
            mixture_weight = 1 - max(min(odds / (1 + odds), by_width), least)
        if self.small.any() and (alpha is None or alpha >= NARROW):
            own, rest = masses[self.small].sum(), masses[~self.small].sum()
            odds = 0.75 * np.sqrt(own / rest) if rest > 0 else 0
            quarters = max(np.floor(4 * mixture_weight * odds / (1 + odds) + 0.5), 1)
            quarters -= 0.25 * quarters > 0.875 * mixture_weight
            if own > 0.05 * (own + rest) and rest > 0 and quarters > 0:
                part = 0.25 * quarters / mixture_weight
                masses[self.small] *= part / (1 - part) * rest / own
        return masses / max(masses.sum(), 1e-300), mixture_weight

    def pdf(self, n, wo, wi, alpha=None):
        """Returns the solid-angle density of directions [count, 3] in 1/sr, for a diffuse surface or a rough
        mirror of width `alpha`."""
        of_clusters, mixture_weight = self.cluster_probabilities(n, wo, alpha)
        u = np.arctan2(wi[:, 0], -wi[:, 2]) / (2 * np.pi) % 1
        v = np.arctan2(np.hypot(wi[:, 0], wi[:, 2]), wi[:, 1]) / np.pi
        column = ((u * self.light.columns - 0.5) % self.light.columns).astype(int)
        row = np.minimum((v * self.light.rows).astype(int), self.light.rows - 1)
        per_light, known = np.zeros(len(wi)), {}

        def pick(nodes, place, key):
            if key not in known:
                masses = np.array([self.mass(node, n, wo, alpha, leaf=True) for node in nodes])
                known[key] = masses / max(masses.sum(), 1e-300)
            holds = [c <= place[0] < c + w and r <= place[1] < r + h for c, r, w, h in nodes]
            return holds.index(True), known[key]

        for k, place in enumerate(zip(column, row)):
            cluster = [c <= place[0] < c + w and r <= place[1] < r + h for c, r, w, h in self.clusters].index(True)
            leaf, masses = pick(self.leaves[cluster], place, (cluster,))
            node, probability = self.leaves[cluster][leaf], of_clusters[cluster] * masses[leaf]
            if alpha is not None and alpha < NARROW:
                twig, masses = pick(self.twigs[cluster][leaf], place, (cluster, leaf))
                node, probability = self.twigs[cluster][leaf][twig], probability * masses[twig]
            per_light[k] = probability / self.light.moments(node)[0]
        pdf = per_light * self.light.density(u, v) / (2 * np.pi**2 * np.sin(np.pi * v))
        return pdf if alpha is None else mixture_weight * pdf + (1 - mixture_weight) * self.brdf_pdf(n, wo, wi, alpha)

    @staticmethod
    def brdf_pdf(n, wo, wi, alpha):
        """Returns the pdf of sampling visible normals of the Trowbridge-Reitz distribution."""
        h = wi + wo
        h /= np.linalg.norm(h, axis=1, keepdims=True)
        cos_h, cos_o = h @ n, n @ wo
        density = alpha**2 / (np.pi * (cos_h**2 * (alpha**2 - 1) + 1) ** 2)
        return np.where(wi @ n > 0, density / (2 * (cos_o + np.hypot(cos_o, alpha * np.sqrt(1 - cos_o**2)))), 0)
