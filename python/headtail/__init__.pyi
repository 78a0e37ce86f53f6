from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, NamedTuple, Protocol, TypedDict

import numpy as np
import numpy.typing as npt
from typing_extensions import Unpack

class _DLPack(Protocol):
    def __dlpack__(self, **settings: Any) -> Any: ...
    def __dlpack_device__(self) -> tuple[Any, int]: ...

_Array = npt.ArrayLike | _DLPack
_Path = str | PathLike[str]
_Floats = npt.NDArray[np.float32]

class HeadtailError(ValueError): ...

class Environment:
    def __init__(self, name_or_path: _Path, *, layout: str | None = ..., layer: str | None = ...) -> None: ...
    @classmethod
    def from_array(cls, texels: _Array, name: str = ..., *, layout: str | None = ...) -> Environment: ...
    @property
    def name(self) -> str: ...
    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def hash(self) -> str: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def warnings(self) -> list[str]: ...
    def array(self) -> _Floats: ...
    def radiance(self, wi: _Array, out: _Array | None = ...) -> _Floats: ...

class Draws(NamedTuple):
    wi: _Floats
    pdf: _Floats
    radiance: _Floats | None

class Material:
    def __init__(self, name: str) -> None: ...
    @property
    def name(self) -> str: ...

class _Surface(TypedDict, total=False):
    roughness: _Array | float
    metallic: _Array | float
    base_color: _Array
    material: Material
    uv: _Array
    tangent: _Array
    footprint: _Array | float

def brdf_cosine(
    wi: _Array,
    n: _Array,
    wo: _Array | None = ...,
    alpha: _Array | float | None = ...,
    f0: _Array | float | None = ...,
    *,
    out: _Array | None = ...,
    **surface: Unpack[_Surface],
) -> _Floats: ...

class Sampler:
    def __init__(self, native: Any) -> None: ...
    @classmethod
    def from_spec(cls, spec: str, env: Environment | _Path | _Array) -> Sampler: ...
    @classmethod
    def open(cls, path: _Path, env: Environment | _Path | _Array | None = ...) -> Sampler: ...
    @property
    def info(self) -> dict[str, Any]: ...
    def sample(
        self,
        n: _Array,
        wo: _Array | None = ...,
        alpha: _Array | float | None = ...,
        f0: _Array | float | None = ...,
        u: _Array | None = ...,
        *,
        count: int | None = ...,
        seed: int = ...,
        radiance: bool = ...,
        out: tuple[_Array | None, _Array | None, _Array | None] | None = ...,
        p: _Array | None = ...,
        **surface: Unpack[_Surface],
    ) -> Draws: ...
    def pdf(
        self,
        wi: _Array,
        n: _Array,
        wo: _Array | None = ...,
        alpha: _Array | float | None = ...,
        f0: _Array | float | None = ...,
        *,
        out: _Array | None = ...,
        p: _Array | None = ...,
        **surface: Unpack[_Surface],
    ) -> _Floats: ...
    def prepare(
        self,
        n: _Array,
        wo: _Array | None = ...,
        alpha: _Array | float | None = ...,
        f0: _Array | float | None = ...,
        *,
        count: int | None = ...,
        p: _Array | None = ...,
        **surface: Unpack[_Surface],
    ) -> PreparedPoints: ...
    def save(self, path: _Path) -> None: ...

class PreparedPoints:
    def __init__(self, native: Any) -> None: ...
    def __len__(self) -> int: ...
    def sample(
        self,
        u: _Array | None = ...,
        *,
        seed: int = ...,
        radiance: bool = ...,
        out: tuple[_Array | None, _Array | None, _Array | None] | None = ...,
    ) -> Draws: ...
    def pdf(self, wi: _Array, *, out: _Array | None = ...) -> _Floats: ...

class Scene:
    def __init__(self, name_or_path: _Path, *, material: str | None = ..., ground: bool = ..., camera: str | None = ...) -> None: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def warnings(self) -> list[str]: ...
    @property
    def triangle_count(self) -> int: ...
    def triangles(self) -> _Floats: ...
    @property
    def camera(self) -> tuple[list[float], list[float], float]: ...
    @property
    def is_diffuse(self) -> bool: ...

class Rendering(NamedTuple):
    image: _Floats
    coverage: _Floats
    sampler: str
    spp: int
    seconds: float
    rays_per_sample: float

class Reference(NamedTuple):
    image: _Floats
    covered: npt.NDArray[np.bool_]
    spp: int
    mse: float
    relmse: float

def bake(
    source: Sampler | Environment | _Path | _Array,
    *,
    normals: Sequence[int] = ...,
    cells: Sequence[int] = ...,
    tail: str = ...,
) -> Sampler: ...
def fit(
    env: Environment | _Path | _Array,
    material: str = ...,
    *,
    preset: str | None = ...,
    progress: Callable[[dict[str, Any]], Any] | None = ...,
    checkpoint_dir: _Path | None = ...,
    checkpoint_every: int = ...,
    resume: bool = ...,
    reproducible: bool = ...,
    **settings: Any,
) -> Sampler: ...
def settings(material: str | None = ..., *, preset: str | None = ..., **settings: Any) -> str: ...
def render(
    scene: Scene | _Path,
    sampler: Sampler | str = ...,
    env: Environment | _Path | _Array | None = ...,
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
    scene: Scene | _Path,
    env: Environment | _Path | _Array,
    samplers: Sequence[Sampler | str],
    *,
    spp: Sequence[int] = ...,
    seconds: Sequence[float] = ...,
    runs: int = ...,
    seed: int = ...,
    reference_spp: int = ...,
    reference: Reference | Rendering | _Array | None = ...,
    progress: Callable[[float], Any] | None = ...,
    **view: Any,
) -> tuple[np.ndarray[Any, Any], Reference]: ...
