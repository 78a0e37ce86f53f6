// One-sample MIS with the mixture weight 1/2.

const headtail_weight: f32 = 0.5;

fn headtail_begin(at: HeadtailPoint) {
    headtail_find_cell(at.p, at.ns);
    headtail_position = at.p;
    headtail_prepare(HeadtailSurface(at.ns, at.wo, at.lobes));
}
