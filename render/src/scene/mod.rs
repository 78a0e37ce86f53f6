//! Scenes: triangle meshes, materials, cameras.
