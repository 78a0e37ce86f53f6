//! One sample of each pixel of a tile: camera rays, the mask, light on the object, and light between object
//! and catcher.

use glam::{DVec3, DVec4, Vec3, Vec3A};

use super::{
    catcher::Backdrop,
    composition::{Composition, Settings},
    film::CatcherSums,
};
use crate::{
    brdf::Lambert,
    color::luminance,
    columns::Arena,
    estimator::{Contributions, LearningSession},
    integrator::{
        path::{BOUNCE_SPREAD, bounce, camera_rays, key_of, shadow_rays},
        tiles::TilePixels,
    },
    points::Points,
    scene::{Ray, RayKind},
    tile::{ShadingPoint, Tile},
};

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Default)]
pub(super) struct Sums {
    pub catcher: CatcherSums,
    pub object_hits: u32,
    pub object: DVec3,
    pub mask_rays: u64,
    pub other_rays: u64,
}

/// The sum to which the light of a path is added.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Goal {
    /// Light on the object in this pixel.
    Object,
    /// Light that the object reflects onto the catcher in this pixel.
    ThrownBack,
}

/// The path that leads to a shading point.
#[derive(Clone, Copy, Debug)]
struct Path {
    pixel: usize,
    goal: Goal,
    /// Whether the last surface is the catcher.
    from_catcher: bool,
    throughput: Vec3A,
}

/// Shading points of one kind, with the paths to them.
#[derive(Default)]
struct Front {
    tile: Tile,
    paths: Vec<Path>,
}

impl Front {
    fn push(&mut self, point: &ShadingPoint, key: u32, path: Path) {
        self.tile.push(point, key);
        self.paths.push(path);
    }
}

/// Buffers of one thread, reused from tile to tile.
#[derive(Default)]
pub(super) struct Workspace {
    arena: Arena,
    object: Front,
    catcher: Front,
    contributions: Contributions,
    rays: Vec<Ray>,
    visible: Vec<bool>,
    /// Whether each contribution to the catcher is unblocked by the catcher.
    open: Vec<bool>,
}

/// One sample of each pixel of a tile.
pub(super) struct Worker<'a> {
    pub composition: Composition<'a>,
    pub settings: Settings,
    /// Receives the visibility of contributions.
    pub session: Option<&'a LearningSession<'a>>,
    pub points: Points,
    pub workspace: &'a mut Workspace,
    pub pixels: TilePixels<'a, Sums>,
}

impl Worker<'_> {
    pub fn sample(&mut self) {
        self.trace_camera();
        self.mask();
        if self.settings.mask_only {
            return;
        }
        for bounce in 0..self.settings.depth.max(1) {
            self.points = self.points.at_bounce(bounce);
            self.light_object();
            if bounce > 0 {
                self.light_catcher();
            }
            if bounce + 1 < self.settings.depth {
                self.continue_paths(bounce + 1);
            }
        }
    }

    /// Traces one camera ray per pixel.
    fn trace_camera(&mut self) {
        let Self { composition, settings, points, workspace, pixels, .. } = self;
        let mut rays = Vec::new();
        let size = (settings.width, settings.height);
        camera_rays(composition.camera, size, pixels.places, points, &mut rays, &workspace.arena);
        let keys: Vec<u32> = pixels.places.iter().map(|&place| key_of(place)).collect();
        let path = |pixel| Path { pixel, goal: Goal::Object, from_catcher: false, throughput: Vec3A::ONE };
        let paths: Vec<Path> = (0..rays.len()).map(path).collect();
        let spread = composition.camera.pixel_spread(settings.height);
        self.meet(RayKind::Camera, &rays, spread, &keys, &paths);
        let Self { workspace, pixels, .. } = self;
        for path in &workspace.object.paths {
            pixels.sums[path.pixel].object_hits += 1;
        }
        for path in &mut workspace.catcher.paths {
            path.goal = Goal::ThrownBack;
            pixels.sums[path.pixel].catcher.hits += 1;
        }
    }

    /// Fills both fronts with the hits of rays. Light between points of the catcher is omitted, since the
    /// photograph contains it.
    fn meet(&mut self, kind: RayKind, rays: &[Ray], spread: f32, keys: &[u32], paths: &[Path]) {
        let Self { composition, workspace, .. } = self;
        let stage = composition.stage;
        let scene = &stage.all;
        let mut hits = vec![None; rays.len()];
        scene.closest_batch(kind, rays, &mut hits);
        for front in [&mut workspace.object, &mut workspace.catcher] {
            front.tile.clear(scene.brdfs());
            front.paths.clear();
        }
        for (index, hit) in hits.iter().enumerate() {
            let Some(hit) = hit else { continue };
            let (ray, path) = (&rays[index], paths[index]);
            let point = scene.surface(ray, hit, spread);
            if !stage.is_catcher(hit) {
                workspace.object.push(&point, keys[index], path);
            } else if stage.faces(&point) && !path.from_catcher {
                let white = ShadingPoint { surface: Lambert { albedo: Vec3::ONE }.into(), ..point };
                workspace.catcher.push(&white, keys[index], path);
            }
        }
    }

    /// Adds the weights of the catcher points that the camera sees.
    fn mask(&mut self) {
        self.propose(Which::Catcher);
        self.test_shadow();
        self.tell(Which::Catcher);
        let Self { composition, workspace, pixels, .. } = self;
        let Workspace { catcher, contributions, visible, open, .. } = &mut **workspace;
        let own = contributions.places().iter().zip(contributions.radiance()).zip(visible.iter().zip(&*open));
        for ((&place, &radiance), (&visible, &open)) in own {
            let n = catcher.tile.point(place as usize).ns;
            let sums = &mut pixels.sums[catcher.paths[place as usize].pixel];
            sums.mask_rays += 1;
            let sums = &mut sums.catcher;
            let weight = relative(radiance, composition.backdrop, n);
            sums.drawn += weight;
            if !open {
                continue;
            }
            sums.draws += 1;
            sums.all += weight;
            sums.all_squares += weight * weight;
            if visible {
                sums.seen += 1;
                sums.visible += weight;
                sums.visible_squares += weight * weight;
            }
        }
    }

    /// Finds the contributions to the catcher that are visible, and those that are open without the object.
    fn test_shadow(&mut self) {
        let Self { composition, workspace, .. } = self;
        let Workspace { catcher, contributions, visible, open, rays, .. } = &mut **workspace;
        let stage = composition.stage;
        shadow_rays(&stage.all, &catcher.tile, contributions, rays);
        open.clear();
        open.resize(rays.len(), true);
        if !stage.is_plane() {
            stage.catcher.visible_batch(rays, open);
        }
        visible.clear();
        visible.resize(rays.len(), true);
        stage.object.visible_batch(rays, visible);
        // Below the horizon, a map shows nearby ground: nothing casts a shadow upwards.
        for ((visible, open), wi) in visible.iter_mut().zip(&*open).zip(contributions.wi()) {
            *visible = (*visible || wi.y <= 0.0) && *open;
        }
    }

    fn propose(&mut self, which: Which) {
        let Workspace { arena, object, catcher, contributions, .. } = &mut *self.workspace;
        contributions.clear();
        let front = if which == Which::Object { object } else { catcher };
        if !front.tile.is_empty() {
            self.composition.estimator.propose(&front.tile.rows(), &self.points, contributions, arena);
        }
    }

    /// Passes the visibility of the contributions to the session.
    fn tell(&self, which: Which) {
        let Workspace { object, catcher, contributions, visible, .. } = &*self.workspace;
        let front = if which == Which::Object { object } else { catcher };
        if let Some(session) = self.session
            && !front.tile.is_empty()
        {
            session.observe(&front.tile.rows(), contributions, visible);
        }
    }

    /// Adds the light of the map on the object.
    fn light_object(&mut self) {
        self.propose(Which::Object);
        let Self { composition, workspace, .. } = self;
        let Workspace { object, contributions, visible, rays, .. } = &mut **workspace;
        let scene = &composition.stage.all;
        shadow_rays(scene, &object.tile, contributions, rays);
        visible.clear();
        visible.resize(rays.len(), true);
        scene.visible_batch(rays, visible);
        self.tell(Which::Object);
        let Self { workspace, pixels, .. } = self;
        let Workspace { object, contributions, visible, .. } = &**workspace;
        for ((&place, &radiance), &visible) in contributions.places().iter().zip(contributions.radiance()).zip(visible)
        {
            let path = &object.paths[place as usize];
            pixels.sums[path.pixel].other_rays += 1;
            if visible {
                add(pixels, path, radiance);
            }
        }
    }

    /// Adds light from the catcher to the object: the photograph, minus the part that the object shadows.
    fn light_catcher(&mut self) {
        self.propose(Which::Catcher);
        self.test_shadow();
        let Self { composition, workspace, pixels, .. } = self;
        let Workspace { catcher, contributions, visible, open, .. } = &mut **workspace;
        let backdrop = composition.backdrop;
        for (place, path) in catcher.paths.iter().enumerate() {
            let (p, _) = catcher.tile.position_and_normal(place);
            add(pixels, path, backdrop.radiance(p));
        }
        let own = contributions.places().iter().zip(contributions.radiance()).zip(visible.iter().zip(&*open));
        for ((&place, &radiance), (&visible, &open)) in own {
            let path = &catcher.paths[place as usize];
            pixels.sums[path.pixel].other_rays += 1;
            if open && !visible {
                let point = catcher.tile.point(place as usize);
                add(pixels, path, -radiance * backdrop.albedo(point.p, point.ns));
            }
        }
    }

    /// Continues paths by BRDF sampling.
    fn continue_paths(&mut self, bounce: u32) {
        let mut next = Bounced::default();
        for which in [Which::Object, Which::Catcher] {
            self.bounce(which, bounce, &mut next);
        }
        self.meet(RayKind::Bounce, &next.rays, BOUNCE_SPREAD, &next.keys, &next.paths);
    }

    fn bounce(&mut self, which: Which, number: u32, next: &mut Bounced) {
        let Self { composition, points, workspace, .. } = self;
        let Workspace { arena, object, catcher, .. } = &mut **workspace;
        let front = if which == Which::Object { object } else { catcher };
        if front.tile.is_empty() {
            return;
        }
        let backdrop = composition.backdrop;
        let throughput = |place: usize, mut reflected: Vec3A| {
            let path = front.paths[place];
            if which == Which::Catcher {
                let point = front.tile.point(place);
                reflected *= match (path.goal, number) {
                    // pi over the irradiance, without the albedo: `Layers` multiplies by the photograph.
                    (Goal::ThrownBack, 1) => std::f32::consts::PI * backdrop.inverse_irradiance(point.ns),
                    // Photographed lamps must not reflect more than they receive.
                    _ => backdrop.albedo(point.p, point.ns).min(Vec3A::ONE),
                };
            }
            path.throughput * reflected
        };
        let scene = &composition.stage.all;
        bounce(scene, &front.tile, (points, number), arena, throughput, |place, throughput, ray| {
            next.rays.push(ray);
            next.keys.push(front.tile.keys()[place]);
            next.paths.push(Path { throughput, from_catcher: which == Which::Catcher, ..front.paths[place] });
        });
    }
}

/// Rays that continue paths.
#[derive(Default)]
struct Bounced {
    rays: Vec<Ray>,
    keys: Vec<u32>,
    paths: Vec<Path>,
}

#[derive(Clone, Copy, PartialEq)]
enum Which {
    Object,
    Catcher,
}

/// Adds light that arrives along a path.
fn add(pixels: &mut TilePixels<'_, Sums>, path: &Path, radiance: Vec3A) {
    let light = (path.throughput * radiance).as_dvec3();
    let sums = &mut pixels.sums[path.pixel];
    match path.goal {
        Goal::Object => sums.object += light,
        Goal::ThrownBack => sums.catcher.thrown_back += light,
    }
}

/// Returns the light that a white surface reflects relative to the unshadowed surface, per channel and for
/// luminance in the units of the photograph.
fn relative(radiance: Vec3A, backdrop: &Backdrop<'_>, n: Vec3A) -> DVec4 {
    let arriving = std::f32::consts::PI * radiance;
    let [own, all] = [arriving, backdrop.irradiance(n)].map(|light| f64::from(luminance(backdrop.seen(light))));
    (arriving * backdrop.inverse_irradiance(n)).as_dvec3().extend(own / all)
}
