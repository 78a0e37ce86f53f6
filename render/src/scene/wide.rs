//! The eight-wide hierarchy: one ray is tested against the eight children of a node at once, one in each SIMD
//! lane, and likewise against eight triangles of a leaf (Wald, Benthin and Boulos 2008, "Getting Rid of
//! Packets").
//!
//! | file | concept |
//! | --- | --- |
//! | `tree.rs` | nodes and blocks, made from a binary tree |
//! | `packet.rs` | neighbouring rays, eight at once |
//! | `nearest.rs` | nearest hits of other rays |
//! | `shadow.rs` | any hit |
//! | `probe.rs` | a ray against boxes and triangles |
//! | `lanes.rs` | eight numbers side by side |

mod lanes;
mod nearest;
mod packet;
mod probe;
mod shadow;
#[cfg(test)]
mod tests;
mod tree;

pub(super) use tree::WideBvh;

use std::cell::RefCell;

use self::{
    lanes::{Eight, Plain},
    nearest::GROUP,
    packet::Packet,
    tree::WIDTH,
};
use super::ray::{Hit, Ray, RayKind};

impl WideBvh {
    /// Finds the nearest hits of at most [`GROUP`] rays: nearly parallel ones as packets, the others singly.
    #[inline(always)]
    fn nearest_of_group<E: Eight>(
        &self,
        simd: E,
        rays: &[Ray],
        hits: &mut [Option<Hit>],
        culls: bool,
        scratch: &mut Scratch,
    ) {
        if self.nodes.is_empty() {
            hits.fill(None);
            return;
        }
        let (mut others, mut count) = ([0; GROUP], 0);
        for (part, rays) in rays.chunks(WIDTH).enumerate() {
            let places = part * WIDTH..part * WIDTH + rays.len();
            match rays.try_into().ok().and_then(|rays| Packet::new(simd, rays)) {
                Some(packet) => self.nearest_of_packet(simd, packet, &mut hits[places], culls, &mut scratch.packet),
                None => {
                    for place in places {
                        others[count] = place as u8;
                        count += 1;
                    }
                }
            }
        }
        if count > 0 {
            self.nearest(simd, rays, &others[..count], hits, culls, &mut scratch.nearest);
        }
    }
}

/// Reusable memory.
#[derive(Default)]
struct Scratch {
    shadow: shadow::Scratch,
    nearest: nearest::Scratch,
    packet: packet::Scratch,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// The query for a batch of rays, with a slot for each answer.
pub(super) enum Question<'a> {
    Nearest(RayKind, &'a mut [Option<Hit>]),
    Occluded(&'a mut [bool]),
}

/// A batch of rays to trace through a hierarchy.
pub(super) struct Traversal<'a> {
    pub bvh: &'a WideBvh,
    pub rays: &'a [Ray],
    pub question: Question<'a>,
}

impl Traversal<'_> {
    /// Answers the query, with AVX2 where the processor has it.
    pub fn run(self) {
        SCRATCH.with_borrow_mut(|scratch| {
            #[cfg(target_arch = "x86_64")]
            if let Some(simd) = pulp::x86::V3::try_new() {
                simd.vectorize(On { simd, traversal: self, scratch });
                return;
            }
            self.answer(Plain, scratch);
        });
    }

    #[inline(always)]
    fn answer<E: Eight>(self, simd: E, scratch: &mut Scratch) {
        let Self { bvh, rays, question } = self;
        match question {
            Question::Nearest(kind, hits) => {
                let culls = kind == RayKind::Camera && bvh.has_single_sided;
                for (rays, hits) in rays.chunks(GROUP).zip(hits.chunks_mut(GROUP)) {
                    bvh.nearest_of_group(simd, rays, hits, culls, scratch);
                }
            }
            Question::Occluded(occluded) => bvh.occluded(simd, rays, occluded, &mut scratch.shadow),
        }
    }
}

/// A traversal compiled for an instruction set.
struct On<'a, 'b, E> {
    simd: E,
    traversal: Traversal<'a>,
    scratch: &'b mut Scratch,
}

impl<E: Eight> pulp::NullaryFnOnce for On<'_, '_, E> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.traversal.answer(self.simd, self.scratch);
    }
}
