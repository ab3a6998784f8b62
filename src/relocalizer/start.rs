//! Intrinsics before and after the pose.

use super::error::LocateError;
use super::options::{CameraSource, FocalBelief, Query};
use crate::geometry::{Camera, Pixel, WorkingFromSensor};
use crate::math::elementary::ln;
use crate::pose::{Focal, PoseEstimate};
use crate::scene_file::SceneInfo;

/// Focal length divided by the longer side where nothing is known: the middle of phones' video cameras.
const ASSUMED_FOCAL: f64 = 0.85;

/// So many of a scene's cameras are tried.
const MAX_SCENE_CAMERAS: usize = 3;

/// So many starts there are after the first: other cameras of the scene, or what may be wrong with a given one.
const MAX_REST: usize = 4;

/// What earlier frames say of a camera agrees with one of the scene's up to this difference of ln f, and so many deviations.
const AGREEING_LN: f64 = 0.02;
const AGREEING_SIGMAS: f64 = 3.0;

/// A given camera that differs by less in its ratio of focal lengths, or, as a share of the longer side, in its principal point, is
/// not doubted: less is told by the matches that were found, where it matters.
const LEAST_SQUEEZE_LN: f64 = 0.05;
const LEAST_SHIFT: f64 = 0.05;
/// Nor one whose distortion moves the picture near its corners by less than this against the scene's, as a share of the longer side.
const LEAST_BEND: f64 = 0.02;

/// A camera in pixels of the frame, where it comes from, and how free its focal length is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub(super) camera: Camera,
    pub(super) source: CameraSource,
    pub(super) focal: Focal,
}

/// What the solver starts from, in this order, until there is an answer.
#[derive(Debug, Clone, Copy)]
pub(super) struct Starts {
    pub(super) first: Start,
    rest: [Option<Start>; MAX_REST],
    /// Whether the rest doubts a given camera of a part of a picture, which is more often right than wrong.
    pub(super) is_of_part: bool,
}

impl Starts {
    /// For a frame of this size: the intrinsics that came with it; without any the scene's own cameras for pictures of its shape,
    /// unless earlier frames say that it is another one; then a guess.
    /// `is_checked` where a second look finds out that a camera is not that of the frame.
    pub(super) fn new(
        size: (u32, u32),
        query: &Query,
        scene: &SceneInfo,
        is_checked: bool,
    ) -> Result<Self, LocateError> {
        let alone = |first| Self {
            first,
            rest: [None; MAX_REST],
            is_of_part: false,
        };
        if let Some(camera) = query.camera {
            let mut starts = alone(Start::given(size, camera, query.camera_source)?);
            if let Some(own) = scene.camera.filter(|_| is_checked) {
                starts.rest = Start::doubts(&own, &camera);
                starts.is_of_part = own.for_size(size.0, size.1).is_none();
            }
            return Ok(starts);
        }
        let (width, height) = size;
        let mut cameras = scene
            .cameras_for(width, height)
            .map(|camera| Start::of_scene(camera, is_checked));
        if let Some(belief) = query.focal {
            let focal_px = belief.focal_per_width * f64::from(width);
            let most = AGREEING_LN.max(AGREEING_SIGMAS * belief.sigma_ln);
            let own = cameras.find(|s| ln(s.camera.focal_px().0 / focal_px).abs() <= most);
            return Ok(alone(own.unwrap_or_else(|| Start::believed(size, belief))));
        }
        let Some(first) = cameras.next() else {
            return Ok(alone(Start::assumed(size)));
        };
        let mut starts = alone(first);
        let others = cameras.take(MAX_SCENE_CAMERAS - 1);
        for (room, start) in (starts.rest.iter_mut()).zip(others.chain([Start::assumed(size)])) {
            *room = Some(start);
        }
        Ok(starts)
    }

    /// Those after the first.
    pub(super) fn rest(&self) -> impl Iterator<Item = Start> + use<> {
        self.rest.into_iter().flatten()
    }
}

impl Start {
    /// Intrinsics that came with a frame.
    fn given(
        (width, height): (u32, u32),
        camera: Camera,
        source: CameraSource,
    ) -> Result<Self, LocateError> {
        camera.validate()?;
        if (camera.width, camera.height) != (width, height) {
            return Err(LocateError::CameraSize {
                camera_width: camera.width,
                camera_height: camera.height,
                width,
                height,
            });
        }
        Ok(Self {
            camera,
            source,
            focal: match source.sigma_ln() {
                None => Focal::Known,
                Some(sigma_ln) => Focal::Refine { sigma_ln },
            },
        })
    }

    /// A camera of the pictures that taught the scene. Where nobody checks it, it is as good as what EXIF says.
    fn of_scene(camera: Camera, is_checked: bool) -> Self {
        let unchecked = CameraSource::Exif.sigma_ln().filter(|_| !is_checked);
        Self {
            camera,
            source: CameraSource::Scene,
            focal: unchecked.map_or(Focal::Known, |sigma_ln| Focal::Refine { sigma_ln }),
        }
    }

    /// What earlier frames of the camera say.
    fn believed((width, height): (u32, u32), belief: FocalBelief) -> Self {
        let focal_px = belief.focal_per_width * f64::from(width);
        Self {
            camera: Camera::centered(width, height, focal_px),
            source: CameraSource::Remembered,
            focal: if belief.is_frozen() {
                Focal::Known
            } else {
                Focal::Refine {
                    sigma_ln: belief.sigma_ln,
                }
            },
        }
    }

    /// What may be wrong with a given camera, `own` being the scene's: its principal point, where that is not the scene's own in a
    /// picture of this size, its distortion, where that is not the scene's, and its ratio of focal lengths. A picture of the scene's
    /// own shape should have the scene's ratio, one of another shape that ratio where it is a part of a picture, which is asked about,
    /// and a stretched one where it was squeezed, which nobody says by mistake. The ratio is mended by the one focal length, and by
    /// the other; before a flat wall both may do as well, and what is nearer to the scene's own camera comes first.
    fn doubts(own: &Camera, camera: &Camera) -> [Option<Self>; MAX_REST] {
        let doubted = |camera| Self {
            camera,
            source: CameraSource::Estimated,
            focal: Focal::Known,
        };
        let whole = own.stretched_to(camera.width, camera.height);
        let (center, told) = (whole.principal_point(), camera.principal_point());
        let shift = (center.x - told.x).abs().max((center.y - told.y).abs());
        let is_shifted = shift > LEAST_SHIFT * f64::from(camera.width.max(camera.height));
        let aligned = if is_shifted {
            camera.with_principal_point(center)
        } else {
            *camera
        };
        let like_own = |c: &Camera| {
            let ((fx, fy), (x, y)) = (c.focal_px(), whole.focal_px());
            let bent = whole.with_principal_point(c.principal_point());
            bent.with_focals_scaled([fx / x, fy / y])
        };
        let is_bent = is_bent(camera, &like_own(camera));
        let ratio = |c: &Camera| c.focal_px().1 / c.focal_px().0;
        let [as_part, as_whole] = [own, &whole].map(|c| ratio(c) / ratio(camera));
        let is_fitting = |factor: f64| ln(factor).abs() <= LEAST_SQUEEZE_LN;
        let factor = if is_fitting(as_part) {
            as_whole
        } else {
            as_part
        };
        let is_squeezed = !is_fitting(as_whole);
        let mut doubts =
            [[1.0, factor], [1.0 / factor, 1.0]].map(|factors| aligned.with_focals_scaled(factors));
        let wide = |c: &Camera| c.focal_px().0 / f64::from(c.width);
        let [by_x, by_y] = doubts.map(|c| ln(wide(&c) / wide(own)).abs());
        if by_y < by_x {
            doubts.reverse();
        }
        let [first, second] = doubts.map(|c| is_squeezed.then_some(doubted(c)));
        [
            is_bent.then(|| doubted(like_own(&aligned))),
            is_shifted.then_some(doubted(aligned)),
            first,
            second,
        ]
    }

    /// Whether it stands for a given camera that is doubted.
    pub(super) fn is_doubt(&self) -> bool {
        self.source == CameraSource::Estimated
    }

    /// Whether somebody says that it is this frame's camera.
    pub(super) fn is_claimed(&self) -> bool {
        !matches!(self.source, CameraSource::Scene | CameraSource::Assumed)
    }

    /// Of a camera of which nothing is known.
    fn assumed((width, height): (u32, u32)) -> Self {
        let focal_px = ASSUMED_FOCAL * f64::from(width.max(height));
        Self {
            camera: Camera::centered(width, height, focal_px),
            source: CameraSource::Assumed,
            focal: Focal::Unknown,
        }
    }

    /// The camera as solved, and the relative standard deviation of its focal length, `None` where it was given. Intrinsics that
    /// contradict what was seen were replaced; they are estimated ones then.
    /// `in_working` is the camera that the solver was handed, in the picture that `working` leads to.
    pub(super) fn solved(
        &self,
        in_working: &Camera,
        working: &WorkingFromSensor,
        estimate: &PoseEstimate,
    ) -> (Camera, CameraSource, Option<f64>) {
        let (fx, fy) = estimate.camera.focal_px();
        let (given_fx, given_fy) = in_working.focal_px();
        let is_scaled = estimate.camera.principal_point() == in_working.principal_point()
            && (fy * given_fx - fx * given_fy).abs() < 1e-9 * fx * given_fy;
        let factor = fx / given_fx;
        if self.focal == Focal::Known && is_scaled && factor == 1.0 {
            return (self.camera, self.source, None);
        }
        let camera = if is_scaled {
            self.camera.with_focal_scaled(factor)
        } else {
            Camera {
                width: self.camera.width,
                height: self.camera.height,
                ..estimate.camera.resized(&working.inverse())
            }
        };
        let source = match (self.source, self.focal) {
            (CameraSource::Assumed, _) | (_, Focal::Known) => CameraSource::Estimated,
            // Refined as far as this it is another camera than the scene's.
            (CameraSource::Scene, Focal::Refine { sigma_ln }) if ln(factor).abs() > sigma_ln => {
                CameraSource::Estimated
            }
            _ if !is_scaled => CameraSource::Estimated,
            (other, _) => other,
        };
        (camera, source, Some(estimate.sigma_focal_px / fx))
    }
}

/// Whether two cameras that differ in their distortion alone see clearly different pictures near the corners.
fn is_bent(camera: &Camera, other: &Camera) -> bool {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let corners = [(0.05, 0.05), (0.95, 0.05), (0.05, 0.95), (0.95, 0.95)];
    corners.iter().any(|(x, y)| {
        let at = Pixel::new(x * width, y * height);
        let seen = |c: &Camera| c.bearing_from_pixel(at);
        match (seen(camera), seen(other)) {
            // Where one of them sees nothing at all they differ.
            (Some(bearing), Some(_)) => other
                .pixel_from_cam(&bearing)
                .is_none_or(|there| there.distance(at) > LEAST_BEND * width.max(height)),
            (a, b) => a.is_some() != b.is_some(),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::CameraModel;
    use crate::models::ExtractorKind;

    fn scene(focals: &[(u32, u32, f64)]) -> SceneInfo {
        let mut cameras = focals.iter().map(|&(w, h, f)| Camera::centered(w, h, f));
        SceneInfo {
            camera: cameras.next(),
            other_cameras: cameras.collect(),
            ..SceneInfo::new(ExtractorKind::Xfeat, "")
        }
    }

    /// Focal length, source, and whether it is taken as known, in the order of trying.
    fn starts(
        size: (u32, u32),
        query: &Query,
        scene: &SceneInfo,
    ) -> Vec<(f64, CameraSource, bool)> {
        let starts = Starts::new(size, query, scene, true).expect("makes sense");
        let all = core::iter::once(starts.first).chain(starts.rest());
        all.map(|s| (s.camera.focal_px().0, s.source, s.focal == Focal::Known))
            .collect()
    }

    #[test]
    fn cameras_of_the_scene_come_first_scaled_to_pictures_of_their_shape() {
        let query = Query::default();
        let scene = scene(&[(640, 480, 500.0), (1280, 720, 1100.0), (1280, 960, 1200.0)]);
        let own = |f| (f, CameraSource::Scene, true);
        let guess = |f| (f, CameraSource::Assumed, false);
        assert_eq!(
            starts((320, 240), &query, &scene),
            [own(250.0), own(300.0), guess(272.0)]
        );
        assert_eq!(
            starts((640, 360), &query, &scene),
            [own(550.0), guess(544.0)]
        );
        // Turned, cropped, or of a scene that does not know its camera.
        assert_eq!(starts((480, 640), &query, &scene), [guess(544.0)]);
        assert_eq!(starts((640, 400), &query, &scene), [guess(544.0)]);
        let nothing = SceneInfo::new(ExtractorKind::Xfeat, "");
        assert_eq!(starts((320, 240), &query, &nothing), [guess(272.0)]);
    }

    #[test]
    fn what_comes_with_the_frame_or_was_learned_of_its_camera_counts_more() {
        let scene = scene(&[(640, 480, 500.0), (640, 480, 600.0)]);
        let given = Query::with_camera(Camera::centered(640, 480, 700.0));
        assert_eq!(
            starts((640, 480), &given, &scene),
            [(700.0, CameraSource::Given, true)]
        );
        // Squeezed, unlike the scene's own: as it is, then with either focal length as the other says.
        let squeezed = Camera::centered(640, 480, 700.0).with_focals_scaled([1.0, 0.8]);
        assert_eq!(
            starts((640, 480), &Query::with_camera(squeezed), &scene),
            [
                (700.0, CameraSource::Given, true),
                (560.0, CameraSource::Estimated, true),
                (700.0, CameraSource::Estimated, true)
            ]
        );
        let learned = |focal_px: f64| Query {
            focal: Some(FocalBelief {
                focal_per_width: focal_px / 640.0,
                sigma_ln: 0.004,
            }),
            ..Query::default()
        };
        // It agrees with one of them, which is known to the last digit then; or it is another camera.
        assert_eq!(
            starts((640, 480), &learned(607.0), &scene),
            [(600.0, CameraSource::Scene, true)]
        );
        let [(focal_px, source, _)] = starts((640, 480), &learned(550.0), &scene)[..] else {
            panic!("one start");
        };
        assert!((focal_px - 550.0).abs() < 1e-9);
        assert_eq!(source, CameraSource::Remembered);
    }

    #[test]
    fn a_given_camera_is_doubted_where_it_cannot_be_the_whole_pictures() {
        let scene = scene(&[(640, 480, 500.0)]);
        let doubts = |camera: Camera| {
            let query = Query::with_camera(camera);
            let starts = Starts::new((camera.width, camera.height), &query, &scene, true);
            let starts = starts.expect("makes sense");
            let numbers = |s: Start| {
                let at = s.camera.principal_point();
                let (fx, fy) = s.camera.focal_px();
                [fx, fy, at.x, at.y].map(|v| v.round() as i32)
            };
            (
                starts.is_of_part,
                starts.rest().map(numbers).collect::<Vec<_>>(),
            )
        };
        let (whole, other_shape) = (false, true);
        // Another lens of the same kind is as likely as the scene's.
        assert_eq!(
            doubts(Camera::centered(640, 480, 700.0)),
            (whole, Vec::new())
        );
        let shifted =
            Camera::centered(640, 480, 700.0).with_principal_point(Pixel::new(20.0, 240.0));
        assert_eq!(doubts(shifted), (whole, vec![[700, 700, 320, 240]]));
        // The lower part of a picture, or all of it squeezed: the one may be meant where the other is said.
        let part = Camera::centered(640, 400, 500.0).with_principal_point(Pixel::new(320.0, 160.0));
        let squeezed = [[500, 417, 320, 200], [600, 500, 320, 200]];
        assert_eq!(
            doubts(part),
            (
                other_shape,
                [[500, 500, 320, 200]].into_iter().chain(squeezed).collect()
            )
        );
        // A distortion that the scene's camera does not have, or too little of one to matter.
        let radial = |k: f64| Camera {
            model: CameraModel::from_colmap("SIMPLE_RADIAL", &[700.0, 320.0, 240.0, k])
                .expect("four numbers"),
            ..Camera::centered(640, 480, 700.0)
        };
        assert_eq!(doubts(radial(-0.02)), (whole, Vec::new()));
        for k in [-0.2, 0.5] {
            assert_eq!(doubts(radial(k)), (whole, vec![[700, 700, 320, 240]]));
        }
        let told = Camera::centered(640, 400, 500.0).with_focals_scaled([1.0, 400.0 / 480.0]);
        assert_eq!(doubts(told), (other_shape, Vec::new()));
    }

    /// Without landmarks nobody finds out that a frame is of another camera.
    #[test]
    fn a_camera_that_is_not_checked_is_not_taken_as_known() {
        let scene = scene(&[(640, 480, 500.0)]);
        let starts = Starts::new((640, 480), &Query::default(), &scene, false);
        let first = starts.expect("makes sense").first;
        assert_eq!(first.source, CameraSource::Scene);
        assert!(matches!(first.focal, Focal::Refine { .. }));
    }
}
