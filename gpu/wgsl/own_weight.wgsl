// One-sample MIS with the mixture weight of the sampler.

var<private> headtail_weight: f32;

fn headtail_begin(at: HeadtailPoint) {
    headtail_find_cell(at.p, at.ns);
    headtail_position = at.p;
    headtail_prepare(HeadtailSurface(at.ns, at.wo, at.lobes));
    headtail_weight = headtail_share_here();
}
