from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

class DLPack(Protocol):
    def __dlpack__(self, **settings: Any) -> Any: ...
    def __dlpack_device__(self) -> tuple[Any, int]: ...

Array = npt.ArrayLike | DLPack
Path = str | PathLike[str]
Floats = npt.NDArray[np.float32]

class HeadtailError(ValueError): ...

class Environment:
    def __init__(self, name_or_path: Path) -> None: ...
    @classmethod
    def from_array(cls, texels: Array, name: str = ...) -> Environment: ...
    @property
    def name(self) -> str: ...
    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def hash(self) -> str: ...
    @property
    def repairs(self) -> list[str]: ...
    def array(self) -> Floats: ...
    def radiance(self, wi: Array, out: Array | None = ...) -> Floats: ...

class Draws(NamedTuple):
    wi: Floats
    pdf: Floats
    radiance: Floats | None

class Sampler:
    @classmethod
    def from_spec(cls, spec: str, env: Environment | Path | Array) -> Sampler: ...
    @classmethod
    def open(cls, path: Path, env: Environment | Path | Array | None = ...) -> Sampler: ...
    @property
    def info(self) -> dict[str, Any]: ...
    def sample(
        self,
        n: Array,
        wo: Array | None = ...,
        alpha: Array | float | None = ...,
        f0: Array | float | None = ...,
        u: Array | None = ...,
        *,
        count: int | None = ...,
        seed: int = ...,
        radiance: bool = ...,
        out: tuple[Array | None, Array | None, Array | None] | None = ...,
    ) -> Draws: ...
    def pdf(
        self,
        wi: Array,
        n: Array,
        wo: Array | None = ...,
        alpha: Array | float | None = ...,
        f0: Array | float | None = ...,
        *,
        out: Array | None = ...,
    ) -> Floats: ...
    def save(self, path: Path) -> None: ...

class Scene:
    def __init__(self, name_or_path: Path, *, material: str | None = ..., ground: bool = ...) -> None: ...
    @property
    def triangle_count(self) -> int: ...
    def triangles(self) -> Floats: ...
    @property
    def camera(self) -> tuple[list[float], list[float], float]: ...
    @property
    def is_diffuse(self) -> bool: ...

class Rendering(NamedTuple):
    image: Floats
    coverage: Floats
    spp: int
    seconds: float
    rays_per_sample: float

def bake(
    source: Sampler | Environment | Path | Array,
    *,
    normals: Sequence[int] = ...,
    cells: Sequence[int] = ...,
    tail: str = ...,
) -> Sampler: ...
def fit(
    env: Environment | Path | Array,
    material: str = ...,
    *,
    preset: str | None = ...,
    progress: Callable[[dict[str, Any]], Any] | None = ...,
    checkpoint_dir: Path | None = ...,
    checkpoint_every: int = ...,
    resume: bool = ...,
    reproducible: bool = ...,
    **settings: Any,
) -> Sampler: ...
def settings(material: str | None = ..., *, preset: str | None = ..., **settings: Any) -> str: ...
def render(
    scene: Scene | Path,
    sampler: Sampler | str,
    env: Environment | Path | Array | None = ...,
    *,
    spp: int | None = ...,
    seconds: float | None = ...,
    width: int = ...,
    height: int = ...,
    points: str = ...,
    seed: int = ...,
    depth: int = ...,
    unshadowed: bool = ...,
    look_from: Sequence[float] | None = ...,
    look_at: Sequence[float] | None = ...,
    fov: float | None = ...,
    progress: Callable[[float], Any] | None = ...,
) -> Rendering: ...
def compare(
    scene: Scene | Path,
    env: Environment | Path | Array,
    samplers: Sequence[Sampler | str],
    *,
    spp: Sequence[int] = ...,
    runs: int = ...,
    seed: int = ...,
    reference_spp: int = ...,
    reference: Rendering | None = ...,
    **view: Any,
) -> tuple[np.ndarray[Any, Any], Rendering]: ...
