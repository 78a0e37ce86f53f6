// Without visibility, points have no cells.

fn headtail_find_cell(p: vec3<f32>, n: vec3<f32>) {}
