// One-sample MIS with the mixture weight 1/2.

const headtail_weight: f32 = 0.5;

fn headtail_begin(at: HeadtailPoint) {
    headtail_prepare_point(at);
}
