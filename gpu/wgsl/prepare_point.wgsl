// A sampler at a shading point.

fn headtail_prepare_point(at: HeadtailPoint) {
    headtail_find_cell(at.p, at.ns);
    headtail_position = at.p;
    headtail_tell_material(at);
    headtail_prepare(HeadtailSurface(at.ns, at.wo, at.lobes));
}
