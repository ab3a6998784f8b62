//! A furnished room that is rendered, with everything known exactly: poses, the point behind every pixel, edges.
//!
//! The room is the demo's sample scene and the ground truth of the mapper's tests.
//! Input: a seed. Output: pictures, world points, world edges.
//! World: metres, z up, floor at z = 0, x in 0..6, y in 0..5 (a varied room has its own size). Cameras look along +z of camera space, y down.
//! Surfaces are flat quads with procedural textures in metres and a light map of two light bounces.
//! The same seed gives the same room and the same pictures, whatever the number of threads.

mod alike;
mod build;
mod color;
mod light;
mod noise;
mod patterns;
mod pieces;
mod prints;
mod render;
mod texture;
mod trace;
mod varied;
mod views;

pub use render::{Picture, RenderOptions};
pub use views::{Look, View, query_views, training_views, video_views};

use landline::geometry::{CamFromWorld, Camera, Pixel};
use light::LightMap;
use nalgebra::Vector3;
use texture::Texture;
use trace::{Bvh, Quad};

/// Straight edge of a solid in the room, in world coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// One end.
    pub start_in_world: Vector3<f64>,
    /// The other end.
    pub end_in_world: Vector3<f64>,
}

/// The furnished room.
#[derive(Debug)]
pub struct Room {
    quads: Vec<Quad>,
    textures: Vec<Texture>,
    edges: Vec<Edge>,
    bvh: Bvh,
    light_map: LightMap,
    size_m: [f64; 3],
}

impl Room {
    /// Width (x), depth (y) and height (z) of the sample room, in metres.
    pub const SIZE_M: [f64; 3] = [6.0, 5.0, 2.8];

    /// Furnishes and lights the room. Takes some seconds, nearly all of them for the light map.
    pub fn new(seed: u64) -> Self {
        Self::of(build::furnish(seed, None), Self::SIZE_M, seed)
    }

    /// One of many that look alike: the furniture of [`Self::new`] a little moved, in other colours, under other pictures.
    pub fn alike(seed: u64) -> Self {
        let built = build::furnish(seed, Some(alike::Vary::new(seed)));
        Self::of(built, Self::SIZE_M, seed)
    }

    /// One of many that differ as rooms do: of its own size, with its own furniture, walls and floor. Ten seeds in a row are of
    /// one house, whose doors and windows are the same.
    pub fn varied(seed: u64) -> Self {
        let (built, size_m) = varied::furnish(seed);
        Self::of(built, size_m, seed)
    }

    fn of(built: build::Built, size_m: [f64; 3], seed: u64) -> Self {
        let bvh = Bvh::new(&built.quads);
        let light_map = LightMap::bake(&built.quads, &built.textures, &bvh, seed);
        Self {
            quads: built.quads,
            textures: built.textures,
            edges: built.edges,
            bvh,
            light_map,
            size_m,
        }
    }

    /// Edges of everything solid, also of what is hidden behind something.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The world point that the camera sees at a pixel; `None` when the ray leaves the room.
    pub fn point_at(
        &self,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        pixel: Pixel,
    ) -> Option<Vector3<f64>> {
        let world_from_cam = cam_from_world.inverse();
        let direction = world_from_cam.rotation * camera.bearing_from_pixel(pixel)?;
        let origin = world_from_cam.translation;
        self.bvh
            .nearest(&self.quads, &origin, &direction, f64::INFINITY)
            .map(|hit| origin + hit.distance * direction)
    }

    /// Whether nothing lies between the camera and a world point, up to `slack_m` in front of the point.
    pub fn is_visible(
        &self,
        cam_from_world: &CamFromWorld,
        point_in_world: &Vector3<f64>,
        slack_m: f64,
    ) -> bool {
        let origin = cam_from_world.center_in_world();
        let to_point = point_in_world - origin;
        let distance = to_point.norm();
        self.bvh
            .nearest(
                &self.quads,
                &origin,
                &(to_point / distance),
                distance - slack_m,
            )
            .is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room_and_view() -> (Room, View) {
        let room = Room::new(7);
        let view = training_views(&room, 7, 12, 160, 120)[3];
        (room, view)
    }

    #[test]
    fn point_behind_a_pixel_projects_back_onto_it() {
        let (room, view) = room_and_view();
        for (x, y) in [(0.5, 0.5), (80.0, 60.0), (159.5, 119.5), (33.2, 90.7)] {
            let pixel = Pixel::new(x, y);
            let point = room
                .point_at(&view.camera, &view.cam_from_world, pixel)
                .expect("the room is closed");
            let in_cam = view.cam_from_world.transform_point(&point);
            let back = view
                .camera
                .pixel_from_cam(&in_cam)
                .expect("in front of the camera");
            assert!(back.distance(pixel) < 1e-9);
            assert!(room.is_visible(&view.cam_from_world, &point, 1e-6));
            let behind = point + 0.3 * (point - view.cam_from_world.center_in_world()).normalize();
            assert!(!room.is_visible(&view.cam_from_world, &behind, 1e-6));
        }
    }

    #[test]
    fn same_seed_gives_the_same_picture() {
        let (room, view) = room_and_view();
        let (again, _) = room_and_view();
        let options = RenderOptions::default();
        let a = room.render(&view.camera, &view.cam_from_world, &options);
        let b = again.render(&view.camera, &view.cam_from_world, &options);
        assert_eq!(a.rgb, b.rgb);
        let other = Room::new(8).render(&view.camera, &view.cam_from_world, &options);
        assert_ne!(a.rgb, other.rgb);
    }

    #[test]
    fn varied_rooms_are_of_their_own_size_and_closed() {
        let rooms = [100, 101, 110].map(Room::varied);
        for (i, room) in rooms.iter().enumerate() {
            for other in &rooms[..i] {
                let differs = |axis: usize| (room.size_m[axis] - other.size_m[axis]).abs() > 0.05;
                assert!(differs(0) || differs(1));
                assert_ne!(room.quads.len(), other.quads.len());
            }
            for view in query_views(room, 3, 6, 80, 60) {
                let eye = view.cam_from_world.center_in_world();
                for pixel in [(1.0, 1.0), (79.0, 1.0), (40.0, 30.0), (1.0, 59.0)] {
                    let pixel = Pixel::new(pixel.0, pixel.1);
                    let point = room.point_at(&view.camera, &view.cam_from_world, pixel);
                    let point = point.expect("the room is closed");
                    for axis in 0..3 {
                        let range = -1e-9..room.size_m[axis] + 1e-9;
                        assert!(range.contains(&eye[axis]) && range.contains(&point[axis]));
                    }
                }
            }
        }
        // Of one house: the same height.
        assert_eq!(rooms[0].size_m[2], rooms[1].size_m[2]);
        assert_ne!(rooms[0].size_m[2], rooms[2].size_m[2]);
    }

    #[test]
    fn edges_have_the_size_of_furniture() {
        let (room, _) = room_and_view();
        assert!(room.edges().len() > 500);
        for edge in room.edges() {
            let length = (edge.end_in_world - edge.start_in_world).norm();
            assert!(length > 1e-3 && length < 6.1, "edge of {length} m");
        }
    }
}
