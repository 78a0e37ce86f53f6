// An example of use: draws a direction for each point of a list, and evaluates the pdf of another.

struct HeadtailQuery { n: vec3<f32>, u: f32, wo: vec3<f32>, v: f32, lobes: vec4<f32>, wi: vec4<f32> }
struct HeadtailAnswer { wi: vec3<f32>, pdf: f32, pdf_of_given: f32 }

@group(0) @binding(2) var<storage, read> headtail_queries: array<HeadtailQuery>;
@group(0) @binding(3) var<storage, read_write> headtail_answers: array<HeadtailAnswer>;

@compute @workgroup_size(64)
fn headtail_draw(@builtin(global_invocation_id) place: vec3<u32>) {
    if (place.x >= arrayLength(&headtail_queries)) { return; }
    let q = headtail_queries[place.x];
    let drawn = headtail_sample(q.n, q.wo, q.lobes, vec2<f32>(q.u, q.v));
    let given = headtail_pdf(q.n, q.wo, q.lobes, q.wi.xyz);
    headtail_answers[place.x] = HeadtailAnswer(drawn.xyz, drawn.w, given);
}
