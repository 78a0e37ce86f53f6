// Samplers that are not told of the material.

fn headtail_tell_material(at: HeadtailPoint) {}
