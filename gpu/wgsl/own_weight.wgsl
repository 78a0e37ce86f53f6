// One-sample MIS with the mixture weight of the sampler.

var<private> headtail_weight: f32;

fn headtail_begin(at: HeadtailPoint) {
    headtail_prepare_point(at);
    headtail_weight = headtail_share_here();
}
