// Weights of patches by visibility: all light counts as visible.

fn headtail_cluster_weight(cluster: u32) -> f32 {
    return 1.0;
}

fn headtail_part_weight(cluster: u32, part: u32) -> f32 {
    return 1.0;
}
