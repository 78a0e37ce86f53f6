use glam::{Vec2, Vec3, Vec3A};

use super::{Portals, SEARCH, openness, rays::RoomRays, search};
use crate::scene::{Camera, Material, Mesh, Scene};

/// A rectangle of the room's shell, `origin + x u + y v`, with a rectangular hole.
fn panel(positions: &mut Vec<Vec3>, [origin, u, v]: [Vec3; 3], hole: Option<[Vec2; 2]>) {
    let mut add = |low: Vec2, high: Vec2| {
        let at = |x: f32, y: f32| origin + x * u + y * v;
        positions.extend([at(low.x, low.y), at(high.x, low.y), at(high.x, high.y), at(low.x, high.y)]);
    };
    let Some([low, high]) = hole else { return add(Vec2::ZERO, Vec2::ONE) };
    add(Vec2::ZERO, Vec2::new(1.0, low.y));
    add(Vec2::new(0.0, high.y), Vec2::ONE);
    add(Vec2::new(0.0, low.y), Vec2::new(low.x, high.y));
    add(Vec2::new(high.x, low.y), Vec2::new(1.0, high.y));
}

fn scene_of(positions: Vec<Vec3>) -> Scene {
    let triangles = (0..positions.len() as u32).step_by(4).flat_map(|k| [[k, k + 1, k + 2], [k, k + 2, k + 3]]);
    let mesh = Mesh::new(positions, Vec::new(), Vec::new(), triangles.collect(), 0).unwrap();
    Scene::new("room", vec![mesh], vec![Material::diffuse(Vec3A::splat(0.5))], None).unwrap()
}

/// A room of 4 x 3 x 5 m around the origin of its floor, turned around the vertical by `angle`: a window at x = 2
/// in a wall of 0.2 m, and a skylight in its ceiling.
fn room(angle: f32) -> Scene {
    let mut shell = Vec::new();
    let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z];
    let corner = Vec3::new(-2.0, 0.0, -2.5);
    panel(&mut shell, [corner, 4.0 * x, 5.0 * z], None);
    panel(&mut shell, [corner, 3.0 * y, 5.0 * z], None);
    panel(&mut shell, [corner, 4.0 * x, 3.0 * y], None);
    panel(&mut shell, [corner + 5.0 * z, 4.0 * x, 3.0 * y], None);
    let window = Some([Vec2::new(0.3, 0.4), Vec2::new(0.5, 0.8)]);
    panel(&mut shell, [corner + 4.0 * x, 5.0 * z, 3.0 * y], window);
    panel(&mut shell, [corner + 4.2 * x, 5.0 * z, 3.0 * y], window);
    // The reveal of the window.
    let sill = corner + 4.0 * x + 1.5 * z + 1.2 * y;
    panel(&mut shell, [sill, 0.2 * x, 1.0 * z], None);
    panel(&mut shell, [sill + 1.2 * y, 0.2 * x, 1.0 * z], None);
    panel(&mut shell, [sill, 0.2 * x, 1.2 * y], None);
    panel(&mut shell, [sill + 1.0 * z, 0.2 * x, 1.2 * y], None);
    panel(&mut shell, [corner + 3.0 * y, 4.0 * x, 5.0 * z], Some([Vec2::new(0.25, 0.6), Vec2::new(0.5, 0.72)]));
    let turn = glam::Quat::from_rotation_y(angle);
    scene_of(shell.into_iter().map(|p| turn * p).collect())
}

#[test]
fn openings_of_a_room_are_found() {
    // Neither turned room has walls along the axes of the world.
    for angle in [0.0, 0.4, -2.0] {
        let turn = glam::Quat::from_rotation_y(angle);
        let camera = Camera::new((turn * Vec3::new(-1.5, 1.5, -2.0)).into(), Vec3A::new(0.0, 1.0, 0.0), 70.0).unwrap();
        let scene = room(angle);
        let found = Portals::find(&scene, &camera).unwrap();
        assert!(found.coverage(&scene, &camera, 1) > 0.99, "{found:?}");
        assert!((0.005..0.1).contains(&found.openness), "{found:?}");
        let estimate = openness(&scene, &camera, 16);
        assert!((estimate / found.openness - 1.0).abs() < 0.25, "{estimate} {found:?}");
        let [window, skylight] = [[2.1, 1.8, -0.5, 1.0, 1.2], [-0.5, 3.0, 0.8, 1.0, 0.6]];
        assert_eq!(found.portals.len(), 2, "{found:?}");
        for [x, y, z, width, height] in [window, skylight] {
            let center = Vec3A::from(turn * Vec3::new(x, y, z));
            // The wall has a thickness of 0.2 m, and a rectangle a margin of 1 % of its size.
            let portal = found.portals.iter().find(|portal| portal.center.distance(center) < 0.13);
            let portal = portal.unwrap_or_else(|| panic!("{center} {found:?}"));
            let inside = Vec3A::new(0.0, 1.5, 0.0) - portal.center;
            assert!(portal.normal.dot(inside) > 0.0, "{found:?}");
            let sizes = [portal.width, portal.height];
            let is_close = |a: f32, b: f32| (a / b - 1.0).abs() < 0.04;
            assert!(
                is_close(sizes[0], width) && is_close(sizes[1], height)
                    || is_close(sizes[1], width) && is_close(sizes[0], height),
                "{width} x {height} {portal:?}"
            );
            assert!(portal.right().dot(portal.up).abs() < 1e-5 && portal.normal.is_normalized());
        }
    }
}

#[test]
fn portals_do_not_depend_on_threads() {
    let (scene, camera) = (room(0.4), Camera::new(Vec3A::new(0.0, 1.5, 0.0), Vec3A::new(1.0, 1.0, 1.0), 70.0).unwrap());
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Portals::find(&scene, &camera).unwrap())
    };
    assert_eq!(of(1), of(3));
}

#[test]
fn closed_rooms_and_empty_views_have_no_portals() {
    let mut shell = Vec::new();
    panel(&mut shell, [Vec3::ZERO, Vec3::X, Vec3::Z], None);
    let plane = scene_of(shell);
    let away = Camera::new(Vec3A::Y, Vec3A::new(0.0, 3.0, 1.0), 40.0).unwrap();
    let error = Portals::find(&plane, &away).unwrap_err().to_string();
    assert!(error.contains("no ray from the visible surfaces"), "{error}");
    assert_eq!(openness(&plane, &away, 16), 0.0);
}

#[test]
fn round_scenes_are_no_rooms_and_are_searched_along_few_normals() {
    let sphere = Scene::built_in("sphere").unwrap();
    let error = Portals::find(&sphere, &sphere.camera()).unwrap_err().to_string();
    assert!(error.contains("portals are for rooms"), "{error}");
    let portals = search(&sphere, &RoomRays::trace(&sphere, &sphere.camera(), SEARCH, 1).thinned());
    assert!(!portals.is_empty() && portals.iter().all(|portal| portal.width > 0.0), "{portals:?}");
}
