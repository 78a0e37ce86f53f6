//! Sampling does not allocate: a picture with five times the samples makes no more allocations.

mod layers;

use std::{
    alloc::{GlobalAlloc, Layout, System},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use headtail_render::{
    bake::{CellGrid, NormalGrid, direct_bake},
    environment::{Environment, built_in},
    export::{ExportedSampler, Intermediate, TrainingSummary},
    head::{Condition, Head, Mode},
    integrator::{Budget, View, render},
    points::{PointSet, Points},
    random::{Purpose, Stream},
    scene::Scene,
    spec::SamplerSpec,
    tail::{Tail, TailKind},
};
use layers::random_layers;

/// Counts allocations.
struct Counting;

static CALLS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: delegates to the system's allocator; counting does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller upholds the contract of `GlobalAlloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the contract of `GlobalAlloc`.
        unsafe { System.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        CALLS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller upholds the contract of `GlobalAlloc`.
        unsafe { System.realloc(block, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Writes files of heads and of a table and returns the samplers' specifications.
fn files(environment: &Environment, folder: &Path) -> Vec<String> {
    let mut random = Stream::new(5, Purpose::Weights, 0);
    let mut network = |sizes: &[usize]| random_layers(sizes, &mut random, |_| [1.0; 2]);
    let networks = [network(&[5, 16, 13]), network(&[4, 16, 13])];
    let head = Head::new(Condition::Normal, Mode::Coupled, 0.01, Vec::new(), networks).unwrap();
    let head = head.with_mixture_weight(network(&[3, 8, 1])).unwrap();
    let tail = Tail::new(TailKind::Hierarchical, environment.width(), environment.height(), &environment.luminance());
    let table = direct_bake(&tail.unwrap(), NormalGrid::new(8, 16).unwrap(), CellGrid::new(8, 8).unwrap()).unwrap();
    let training = TrainingSummary::default();
    let write = |kind: &str, intermediate, training| {
        let file = folder.join(kind);
        ExportedSampler::new(intermediate, TailKind::Hierarchical, environment, training)
            .unwrap()
            .write(&file)
            .unwrap();
        format!("{kind}:{}", file.display())
    };
    vec![
        write("head+mis", Intermediate::Head(head.clone()), Some(training.clone())),
        write("head", Intermediate::Head(head), Some(training)),
        write("direct", Intermediate::DirectBake(table), None),
    ]
}

/// A single test, since the allocator counts for the whole process.
#[test]
fn sampling_does_not_allocate() {
    // Without samplers that train, which allocate.
    const SAMPLERS: [&str; 8] =
        ["brdf", "emitter", "mis", "mis2", "split:2:mis2-comp", "ris:4", "patches", "split:4:patches"];
    const WIDTH: usize = 32;
    const HEIGHT: usize = 32;
    const FEW: u32 = 32;
    const MANY: u32 = 160;
    // Dispatching a pass of 16 samples to threads allocates once, and buffers grow a few times. Once per tile and
    // pass would be twice as many as allowed.
    let allowed = 2 * (MANY - FEW) as usize / 16;
    let scene = Scene::built_in("dishes").unwrap();
    let environment = Arc::new(built_in("window").unwrap());
    let camera = scene.camera();
    let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let samplers = [SAMPLERS.map(str::to_owned).to_vec(), files(&environment, folder.path())].concat();
    for depth in [1, 3] {
        let view = View {
            scene: &scene,
            camera: &camera,
            environment: &environment,
            width: WIDTH,
            height: HEIGHT,
            unshadowed: false,
            depth,
        };
        for sampler in &samplers {
            let estimator = sampler.parse::<SamplerSpec>().unwrap().build(&environment).unwrap();
            let calls = |spp: u32| {
                let points = Points::new(PointSet::Sobol, 1);
                let stop = AtomicBool::new(false);
                let before = CALLS.load(Ordering::Relaxed);
                threads.install(|| drop(render(view, &*estimator, Budget::Spp(spp), points, &stop, &|_| {})));
                CALLS.load(Ordering::Relaxed) - before
            };
            // The thread's buffers grow once.
            calls(FEW);
            let (few, many) = (calls(FEW), calls(MANY));
            assert!(many <= few + allowed, "{sampler}, depth {depth}: {few} and {many}");
        }
    }
}
