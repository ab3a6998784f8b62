//! The follower on a scene that is a formula, with answers that come late, wrong or not at all.

use super::*;
use crate::geometry::rotation_from_vector;
use crate::math::Rng;
use crate::simd::Level;
use crate::tracker::tests::{Scene, frame, pose_at};
use nalgebra::{Matrix6, Vector3};

const FRAME_MS: f64 = 33.0;

/// A camera that goes to and fro, with its pictures.
struct Film {
    scene: Scene,
    poses: Vec<CamFromWorld>,
    pictures: Vec<Vec<u8>>,
}

impl Film {
    fn new(count: usize) -> Self {
        let scene = Scene::new();
        let pose = |i: usize| pose_at(0.8 * (0.12 * i as f64).sin());
        let poses: Vec<CamFromWorld> = (0..count).map(pose).collect();
        let pictures = poses.iter().map(|pose| scene.render(pose)).collect();
        Self {
            scene,
            poses,
            pictures,
        }
    }

    /// What a relocalizer says, off by an error in the camera.
    fn answer(
        &self,
        i: usize,
        number: u64,
        off: &CamFromWorld,
    ) -> (Answer, Vec<PointCorrespondence>) {
        let truth = self.poses[i];
        let cam_from_world = CamFromWorld::new(
            off.rotation * truth.rotation,
            off.rotation * truth.translation + off.translation,
        );
        let answer = Answer {
            frame: number,
            camera: self.scene.camera,
            cam_from_world,
            covariance: Matrix6::identity().scale(1e-5),
        };
        (answer, self.scene.points(&truth, 0.005))
    }
}

fn nothing() -> CamFromWorld {
    off(0.0, 0.0)
}

fn off(turn: f64, shift: f64) -> CamFromWorld {
    let rotation = rotation_from_vector(&Vector3::new(0.6 * turn, turn, 0.3 * turn));
    CamFromWorld::new(rotation, Vector3::new(shift, -0.5 * shift, 0.5 * shift))
}

fn follower() -> Follower {
    let mut options = FollowOptions::default();
    options.tracker.kernels = Level::Portable;
    Follower::new(options)
}

/// Plays frames from `at` on.
struct Player<'a> {
    film: &'a Film,
    follower: Follower,
    next: usize,
    now_ms: f64,
}

impl<'a> Player<'a> {
    fn new(film: &'a Film) -> Self {
        Self {
            film,
            follower: follower(),
            next: 0,
            now_ms: 0.0,
        }
    }

    fn show(&mut self, picture: &[u8]) -> FollowReport {
        self.now_ms += FRAME_MS;
        let report = self.follower.frame(&frame(picture), self.now_ms, None);
        report.expect("a frame that makes sense")
    }

    fn step(&mut self) -> FollowReport {
        let picture = &self.film.pictures[self.next];
        self.next += 1;
        self.show(picture)
    }

    /// An answer for the frame that is `late` frames old.
    fn answer(&mut self, newest: &FollowReport, late: usize, off: &CamFromWorld) -> AnswerUse {
        let i = self.next - 1 - late;
        let (answer, points) = self.film.answer(i, newest.frame - late as u64, off);
        self.follower
            .localized(&answer, points.into_iter(), std::iter::empty())
    }

    fn error(&self, report: &FollowReport) -> (f64, f64) {
        let pose = report.pose.expect("a pose");
        pose.cam_from_world
            .error_to(&self.film.poses[self.next - 1])
    }
}

#[test]
fn late_answers_give_a_pose_for_every_frame() {
    let film = Film::new(45);
    let mut player = Player::new(&film);
    let mut last = player.step();
    assert_eq!((last.state, last.pose), (FollowState::Searching, None));
    for _ in 0..5 {
        last = player.step();
    }
    assert_eq!(player.answer(&last, 5, &nothing()), AnswerUse::Followed);
    for i in 6..45 {
        last = player.step();
        assert_eq!(last.state, FollowState::Tracking, "frame {i}");
        let (m, rad) = player.error(&last);
        assert!(m < 0.01 && rad < 0.003, "{m} m, {rad} rad at frame {i}");
        let age = last.pose.map(|p| p.age_frames);
        assert!(age.is_some_and(|age| age <= 5 + 9));
        if i % 9 == 0 {
            assert_eq!(player.answer(&last, 4, &nothing()), AnswerUse::Followed);
        }
    }
    // Frames that are long gone, or never were.
    for late in [40, 44] {
        assert_eq!(
            player.answer(&last, late, &nothing()),
            AnswerUse::Unusable(TrackLoss::NoFrame)
        );
    }
}

#[test]
fn answers_are_averaged_and_corrections_fade_in() {
    let film = Film::new(60);
    let mut player = Player::new(&film);
    let mut rng = Rng::from_seed(9);
    let mut last = player.step();
    let (mut shown, mut given, mut count) = (0.0, 0.0, 0);
    let mut jumps = 0.0_f64;
    let mut before: Option<CamFromWorld> = None;
    for i in 1..60 {
        if i % 5 == 1 {
            let error = off(0.004 * rng.normal(), 0.012 * rng.normal());
            given += error.center_in_world().norm();
            player.answer(&last, 0, &error);
        }
        last = player.step();
        let pose = last.pose.expect("followed").cam_from_world;
        if i > 20 {
            shown += player.error(&last).0;
            count += 1;
        }
        // Between frames only the movement is seen, and a small part of a correction.
        let truth = player.film.poses[i] * player.film.poses[i - 1].inverse();
        if let Some(before) = before {
            let (m, _) = (truth * before).error_to(&pose);
            jumps = jumps.max(m);
        }
        before = Some(pose);
    }
    let (shown, given) = (shown / f64::from(count), given / 12.0);
    assert!(shown < 0.8 * given, "{shown} m shown, {given} m given");
    assert!(jumps < 0.7 * given, "{jumps} m from frame to frame");
}

#[test]
fn a_far_answer_has_to_be_confirmed() {
    let film = Film::new(20);
    let mut player = Player::new(&film);
    let mut last = player.step();
    player.answer(&last, 0, &nothing());
    last = player.step();
    // One that is wrong and stands alone changes nothing.
    let wrong = off(0.2, 0.3);
    assert_eq!(player.answer(&last, 0, &wrong), AnswerUse::Unconfirmed);
    last = player.step();
    assert_eq!(last.state, FollowState::Limited(FollowLimit::Jump));
    assert!(player.error(&last).0 < 0.01);
    assert_eq!(player.answer(&last, 0, &nothing()), AnswerUse::Followed);
    last = player.step();
    assert_eq!(last.state, FollowState::Tracking);
    // Two that agree are believed at once.
    assert_eq!(player.answer(&last, 0, &wrong), AnswerUse::Unconfirmed);
    last = player.step();
    assert_eq!(player.answer(&last, 0, &wrong), AnswerUse::Followed);
    last = player.step();
    assert!(
        last.correction
            .is_some_and(|c| c.is_jump && c.distance_px > 20.0)
    );
    let expected = wrong.rotation * player.film.poses[player.next - 1].rotation;
    let pose = last.pose.expect("followed").cam_from_world;
    let angle = vector_from_rotation(&(pose.rotation * expected.transpose())).norm();
    assert!(angle < 0.02, "{angle} rad");
}

#[test]
fn losses_are_states_and_end() {
    let film = Film::new(80);
    let mut player = Player::new(&film);
    let mut last = player.step();
    player.answer(&last, 0, &nothing());
    let dark = vec![20; film.pictures[0].len()];
    // A hand that passes by.
    for _ in 0..4 {
        let report = player.show(&dark);
        assert_eq!(report.pose, None);
        assert_eq!(report.loss, Some(TrackLoss::FewFound));
        assert!(matches!(report.state, FollowState::Limited(_)));
    }
    last = player.step();
    assert_eq!(last.state, FollowState::Tracking);
    // A hand that stays.
    for i in 0..60 {
        let mut other = dark.clone();
        other[i * 7] = 200;
        last = player.show(&other);
    }
    assert_eq!(last.state, FollowState::Searching);
    last = player.step();
    assert_eq!((last.state, last.pose), (FollowState::Searching, None));
    assert_eq!(player.answer(&last, 0, &nothing()), AnswerUse::Followed);
    last = player.step();
    assert_eq!(last.state, FollowState::Tracking);
    // An answer that says nothing leaves the pose.
    player.follower.not_located(last.frame);
    assert_eq!(player.step().state, FollowState::Tracking);
    // Another scene.
    player.follower.reset();
    assert_eq!(player.step().state, FollowState::Searching);
}

#[test]
fn bad_times_sizes_and_hanging_cameras_are_states() {
    let film = Film::new(12);
    let mut player = Player::new(&film);
    let last = player.step();
    player.answer(&last, 0, &nothing());
    player.step();
    player.now_ms -= 500.0;
    assert_eq!(
        player.step().state,
        FollowState::Limited(FollowLimit::Clock)
    );
    assert_eq!(player.step().state, FollowState::Tracking);
    let picture = &film.pictures[4];
    let strange = player.follower.frame(&frame(picture), f64::NAN, None);
    let strange = strange.expect("not an error");
    assert_eq!(strange.state, FollowState::Limited(FollowLimit::Clock));
    assert!(strange.pose.is_some_and(|p| p.age_ms.is_finite()));
    let last = (0..20)
        .map(|_| player.show(picture))
        .last()
        .expect("twenty");
    assert_eq!(last.state, FollowState::Limited(FollowLimit::Frozen));
    let half = FrameView {
        height: 120,
        bytes: &picture[..320 * 120],
        ..frame(picture)
    };
    let resized = player.follower.frame(&half, 5000.0, None).expect("a frame");
    assert_eq!(resized.state, FollowState::Limited(FollowLimit::Resized));
    assert_eq!(resized.pose, None);
    let next = player.follower.frame(&half, 5033.0, None).expect("a frame");
    assert_eq!(next.state, FollowState::Searching);
    // A sensor that lies is not heard.
    let lie = Matrix3::new(2.0, 0.0, 0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0, 1.0);
    assert!(player.follower.frame(&half, 5066.0, Some(&lie)).is_ok());
    // A frame that makes no sense is an error and changes nothing.
    let broken = FrameView {
        bytes: &picture[..10],
        ..frame(picture)
    };
    assert!(player.follower.frame(&broken, 5099.0, None).is_err());
    assert!(player.follower.frame(&half, 5133.0, None).is_ok());
}

#[test]
fn a_first_answer_that_is_late_in_a_fast_pan_is_caught_up_with() {
    // 75 degrees a second: 14 pixels of 320 from frame to frame, a third of the picture until the answer comes.
    let scene = Scene::new();
    let poses: Vec<CamFromWorld> = (0..14)
        .map(|i| {
            let t = f64::from(i);
            let turn = rotation_from_vector(&Vector3::new(0.004 * t, 0.044 * t, 0.0));
            CamFromWorld::new(turn, -(turn * Vector3::new(0.01 * t, 0.0, 0.0)))
        })
        .collect();
    let pictures = poses.iter().map(|pose| scene.render(pose)).collect();
    let film = Film {
        scene,
        poses,
        pictures,
    };
    for late in [3, 8] {
        let mut player = Player::new(&film);
        let mut last = player.step();
        for _ in 0..late {
            last = player.step();
        }
        assert_eq!(player.answer(&last, late, &nothing()), AnswerUse::Followed);
        for _ in 0..3 {
            last = player.step();
            assert_eq!(last.state, FollowState::Tracking, "{late} frames late");
            let (m, rad) = player.error(&last);
            assert!(m < 0.015 && rad < 0.004, "{m} m, {rad} rad");
        }
    }
}
