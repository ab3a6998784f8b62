//! Which room a frame was taken in, frame after frame.

use super::claim::Claim;
use super::index::best_first;
use super::{PlaceError, PlaceIndex, PlaceManifest, RoomScore};
use crate::geometry::CamFromWorld;
use crate::image::FrameView;
use crate::pose::Gravity;
use crate::relocalizer::{
    LoadedScene, NotLocated, Observed, Outcome, Query, Relocalizer, RelocalizerOptions, Report,
};
use crate::scene_file::{ExtractorFile, SceneFile};
use crate::session::{Session, SessionError, SessionQuery, SessionReport};

/// How rooms are chosen, and how many are held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceOptions {
    /// Most rooms that a frame is solved in, where the ranking tells them apart; up to three times as many where it does not.
    pub candidates: usize,
    /// Least confidence of an answer that says which room it is.
    pub min_confidence: f64,
    /// Bytes of scenes that are held; the room in use and the candidates of the frame are held in any case.
    pub max_bytes: usize,
}

impl Default for PlaceOptions {
    fn default() -> Self {
        Self {
            candidates: 3,
            min_confidence: 0.8,
            max_bytes: 128 << 20,
        }
    }
}

/// A room with less than half of the best one's votes is not solved once another has answered: ln 2. In some 95 of 100 pictures of
/// fifty rendered rooms the right one had more.
const CLOSE_SCORE: f32 = 0.7;
/// Two rooms that put the camera at one place do not contradict each other: units of the place, and radians.
const SAME_POSITION: f64 = 0.5;
const SAME_TURN_RAD: f64 = 0.2;

/// What came of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceReport {
    /// As of a session in the room; not located where there is none.
    pub session: SessionReport,
    /// The room.
    pub room: Option<usize>,
    /// Another room that claims the frame as well: which of the two it is stays open, and the frame is not located.
    pub rival: Option<[usize; 2]>,
    /// Whether it is another room than that of the frame before.
    pub has_entered: bool,
    /// The pose in the place, where the room's transform is known.
    pub cam_from_place: Option<CamFromWorld>,
    /// Rooms that were solved.
    pub num_solved: usize,
}

#[derive(Debug)]
struct Held {
    /// While it is in use the relocalizer has it, and this is nothing.
    scene: LoadedScene,
    num_bytes: usize,
    last_used: u64,
}

/// Finds cameras in a place of many rooms, of which it holds some.
#[derive(Debug)]
pub struct Place {
    manifest: PlaceManifest,
    index: PlaceIndex,
    options: PlaceOptions,
    session: Session,
    rooms: Vec<Option<Held>>,
    /// The room that the relocalizer has.
    in_use: Option<usize>,
    /// The room that the camera is in.
    current: Option<usize>,
    observed: Option<Observed>,
    ranking: Vec<RoomScore>,
    candidates: Vec<usize>,
    wanted: Vec<usize>,
    claims: Vec<Claim>,
    num_frames: u64,
}

impl Place {
    /// A place without any room at hand. `change` may alter the options of every room's frames.
    ///
    /// # Errors
    /// [`PlaceError`] when manifest, index and extractor do not belong together, or an option has no meaning.
    pub fn new(
        manifest: PlaceManifest,
        index: PlaceIndex,
        extractor: ExtractorFile,
        options: PlaceOptions,
        change: impl FnOnce(&mut RelocalizerOptions),
    ) -> Result<Self, PlaceError> {
        manifest.check()?;
        let expected: Vec<String> = manifest.rooms.iter().map(|room| room.id.clone()).collect();
        if index.rooms() != expected {
            return Err(PlaceError::IndexRooms {
                found: index.rooms().to_vec(),
                expected,
            });
        }
        let own = (extractor.kind.name(), extractor.source_sha256.as_str());
        if own
            != (
                manifest.extractor.as_str(),
                manifest.extractor_sha256.as_str(),
            )
        {
            return Err(PlaceError::Differs {
                room: manifest.name.clone(),
                what: "extractor",
                found: manifest.extractor.clone(),
                expected: own.0.to_owned(),
            });
        }
        let max_side = manifest.working_max_side as usize;
        let relocalizer = Relocalizer::without_scene(extractor, |options| {
            options.front_end.max_side = max_side;
            change(options);
        })?;
        Ok(Self {
            rooms: manifest.rooms.iter().map(|_| None).collect(),
            manifest,
            index,
            options,
            session: Session::new(relocalizer),
            in_use: None,
            current: None,
            observed: None,
            ranking: Vec::new(),
            candidates: Vec::new(),
            wanted: Vec::new(),
            claims: Vec::new(),
            num_frames: 0,
        })
    }

    /// The manifest.
    pub fn manifest(&self) -> &PlaceManifest {
        &self.manifest
    }

    /// What locates; its scene is that of the last answer's room.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// What locates, to change its options.
    pub fn session_mut(&mut self) -> &mut Session {
        &mut self.session
    }

    /// The room that the camera is in, as far as is known.
    pub fn current(&self) -> Option<usize> {
        self.current
    }

    /// Forgets which room the camera is in, and where. Scenes at hand and focal lengths stay.
    pub fn leave(&mut self) {
        self.current = None;
        self.session.reset();
    }

    /// Whether a room's scene is at hand.
    pub fn has_room(&self, room: usize) -> bool {
        self.rooms.get(room).is_some_and(Option::is_some)
    }

    /// Bytes of the scenes at hand.
    pub fn num_bytes(&self) -> usize {
        self.rooms.iter().flatten().map(|held| held.num_bytes).sum()
    }

    /// All rooms as the last frame was ranked, the likeliest first; as they were before where the room stayed.
    pub fn ranking(&self) -> &[RoomScore] {
        &self.ranking
    }

    /// Rooms whose scenes would have helped with the last frame, the likeliest first. Once they are there, [`Self::resume`]; others
    /// may be wanted then.
    pub fn wanted(&self) -> &[usize] {
        &self.wanted
    }

    /// Rooms beside the current one that are not at hand: what may be fetched while there is time.
    pub fn to_prefetch(&self) -> impl Iterator<Item = usize> + '_ {
        let beside = self.current.and_then(|room| self.manifest.rooms.get(room));
        let ids = beside.into_iter().flat_map(|room| &room.neighbours);
        ids.filter_map(|id| self.manifest.position(id))
            .filter(|room| !self.has_room(*room))
    }

    /// Takes a room's scene. The rooms that were not in use for longest go where there are too many bytes.
    ///
    /// # Errors
    /// [`PlaceError::NoRoom`], or [`PlaceError`] for a scene that does not fit the place.
    pub fn put_room(&mut self, room: usize, scene: SceneFile) -> Result<(), PlaceError> {
        let Some(entry) = self.manifest.rooms.get(room) else {
            return Err(PlaceError::NoRoom {
                id: room.to_string(),
            });
        };
        self.manifest.check_scene(&entry.id, &scene)?;
        let options = self.session.relocalizer().options();
        let refused = |source| PlaceError::Scene {
            room: entry.id.clone(),
            source,
        };
        let scene = LoadedScene::new(scene, options).map_err(refused)?;
        self.drop_room(room)?;
        let held = Held {
            num_bytes: scene.num_bytes(),
            scene,
            last_used: self.num_frames,
        };
        if let Some(slot) = self.rooms.get_mut(room) {
            *slot = Some(held);
        }
        self.evict(room)
    }

    /// Gives a room's scene up.
    ///
    /// # Errors
    /// None that a caller could cause.
    pub fn drop_room(&mut self, room: usize) -> Result<(), PlaceError> {
        if self.in_use == Some(room) {
            self.put_back()?;
        }
        if let Some(slot) = self.rooms.get_mut(room) {
            *slot = None;
        }
        Ok(())
    }

    fn evict(&mut self, newest: usize) -> Result<(), PlaceError> {
        while self.num_bytes() > self.options.max_bytes {
            let is_needed = |room: usize| {
                room == newest || self.current == Some(room) || self.candidates.contains(&room)
            };
            let held = self.rooms.iter().enumerate();
            let oldest = held
                .filter_map(|(room, held)| Some((held.as_ref()?.last_used, room)))
                .filter(|(_, room)| !is_needed(*room))
                .min();
            let Some((_, room)) = oldest else { break };
            self.drop_room(room)?;
        }
        Ok(())
    }

    /// Locates one frame in the rooms that are at hand. `clock` tells milliseconds. Of the query's gravity only the camera's side
    /// counts: each scene knows its own world's.
    ///
    /// # Errors
    /// [`PlaceError::Session`] for a frame, camera or time that makes no sense.
    pub fn locate(
        &mut self,
        frame: &FrameView<'_>,
        query: &SessionQuery<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<PlaceReport, PlaceError> {
        self.observed = None;
        self.num_frames += 1;
        self.candidates.clear();
        let alone = self.session.alone(query)?;
        if let Some(room) = self.current {
            self.take_up(room)?;
        }
        let relocalizer = self.session.relocalizer_mut();
        let observed = relocalizer
            .observe_on_cpu(frame, &alone, clock)
            .map_err(SessionError::from)?;
        self.observed = Some(observed.clone());
        self.answer(observed, query, clock)
    }

    /// Answers the last frame anew, with rooms that have come since. `None` when there was no frame.
    ///
    /// # Errors
    /// As [`Self::locate`].
    pub fn resume(
        &mut self,
        query: &SessionQuery<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Option<PlaceReport>, PlaceError> {
        let Some(observed) = self.observed.clone() else {
            return Ok(None);
        };
        self.answer(observed, query, clock).map(Some)
    }

    fn answer(
        &mut self,
        observed: Observed,
        query: &SessionQuery<'_>,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<PlaceReport, PlaceError> {
        self.wanted.clear();
        let alone = self.session.alone(query)?;
        let mut own = None;
        if let Some(room) = self.current.filter(|room| self.has_room(*room)) {
            let report = self.solve_in(room, &observed, &alone, clock)?;
            // What was found again is calibrated against wrong rooms; agreement alone is not, and the other rooms are asked then. So
            // they are where little was found: through a door a room shows what the next one has as well.
            let is_sure = Claim::of(room, &report).is_some_and(|claim| self.may_win(&claim));
            if report.found_again.is_some() && is_sure {
                return Ok(self.stay(room, report, query, 1));
            }
            own = Some((room, report));
        }
        self.choose_candidates();
        let elsewhere = Query {
            prior: None,
            ..alone
        };
        self.claims.clear();
        let of_own = own.and_then(|(room, report)| Claim::of(room, &report));
        self.claims.extend(of_own);
        let mut num_solved = usize::from(own.is_some());
        let mut last: Option<(usize, Report)> = own;
        let best_score = self.score_of_first();
        for at in 0..self.candidates.len() {
            let (room, score) = (self.candidates[at], self.score_at(at));
            // A room that has answered, or may when it is there, comes before those that are much less likely.
            let has_better = self.best_claim().is_some() || !self.wanted.is_empty();
            if has_better && score < best_score - CLOSE_SCORE {
                break;
            }
            if self.current == Some(room) && own.is_some() {
                continue;
            }
            if !self.has_room(room) {
                self.wanted.push(room);
                continue;
            }
            let report = self.solve_in(room, &observed, &elsewhere, clock)?;
            num_solved += 1;
            self.claims.extend(Claim::of(room, &report));
            last = Some((room, report));
        }
        if let Some([first, second]) = self.rivals() {
            let report = self.refused(last, &observed, NotLocated::Ambiguous, &elsewhere, clock)?;
            let mut answer = self.nowhere(report, query, num_solved);
            answer.rival = Some([first, second]);
            return Ok(answer);
        }
        // A better candidate that is not at hand may be the right one: what was found so far is kept back until it is.
        let best = self.best_claim();
        let is_open = best.is_none_or(|best| self.is_before(&self.wanted, best.room));
        if let Some(best) = best.filter(|_| !is_open) {
            let is_own = own.is_some_and(|(room, _)| room == best.room);
            let report = match last.filter(|(room, _)| *room == best.room) {
                Some((_, report)) => report,
                None => {
                    num_solved += 1;
                    let query = if is_own { &alone } else { &elsewhere };
                    self.solve_in(best.room, &observed, query, clock)?
                }
            };
            return Ok(self.enter(best.room, report, query, num_solved));
        }
        let report = self.refused(last, &observed, NotLocated::FewInliers, &elsewhere, clock)?;
        Ok(self.nowhere(report, query, num_solved))
    }

    /// Ranks the rooms; the best few are candidates, and neighbours of the current one among them count as a little better.
    fn choose_candidates(&mut self) {
        let features = self.session.relocalizer().features();
        self.index.rank(features, &mut self.ranking);
        let beside = self.current.and_then(|room| self.manifest.rooms.get(room));
        if let Some(room) = beside.filter(|room| !room.neighbours.is_empty()) {
            for ranked in &mut self.ranking {
                let id = self.manifest.rooms.get(ranked.room).map(|r| r.id.as_str());
                if id.is_some_and(|id| room.neighbours.iter().any(|n| n == id)) {
                    ranked.score += 0.5 * CLOSE_SCORE;
                }
            }
            best_first(&mut self.ranking);
        }
        // Where many rooms look alike the right one may come late.
        let usual = self.options.candidates.max(1);
        let least = self.score_of_first() - CLOSE_SCORE;
        let close = self.ranking.iter().take_while(|r| r.score >= least).count();
        let best = self.ranking.iter().take(close.clamp(usual, 3 * usual));
        self.candidates.clear();
        self.candidates.extend(best.map(|ranked| ranked.room));
    }

    /// A room that nobody looked into although it ranks as well as one that claims the frame.
    fn unasked(&self, claim: &Claim) -> Option<usize> {
        let ranked = |room| self.ranking.iter().find(|r: &&RoomScore| r.room == room);
        let least = ranked(claim.room)?.score - CLOSE_SCORE;
        let next = self.ranking.get(self.candidates.len())?;
        (next.score >= least && !claim.is_convincing()).then_some(next.room)
    }

    fn score_of_first(&self) -> f32 {
        self.score_at(0)
    }

    fn score_at(&self, at: usize) -> f32 {
        self.ranking.get(at).map_or(0.0, |ranked| ranked.score)
    }

    /// Whether one of some rooms ranks before another one, or as well as it.
    fn is_before(&self, rooms: &[usize], room: usize) -> bool {
        let own = self.ranking.iter().find(|r| r.room == room);
        let least = own.map_or(0.0, |r| r.score) - CLOSE_SCORE;
        let ranked = self.ranking.iter().filter(|r| rooms.contains(&r.room));
        ranked.into_iter().any(|r| r.score > least)
    }

    /// Whether a claim may name the room; a weaker one may still speak against another.
    fn may_win(&self, claim: &Claim) -> bool {
        claim.is_strong() && claim.confidence >= self.options.min_confidence
    }

    fn best_claim(&self) -> Option<Claim> {
        let claims = self.claims.iter().copied().filter(|c| self.may_win(c));
        claims.max_by(|a, b| a.share_found.total_cmp(&b.share_found))
    }

    /// Two rooms of which either may be the one.
    fn rivals(&self) -> Option<[usize; 2]> {
        let best = self.best_claim()?;
        let others = self.claims.iter().filter(|claim| claim.room != best.room);
        let rival = others
            .filter(|other| !best.is_clear_of(other))
            .find(|other| !self.agree(&best, other));
        let rival = rival.map(|other| other.room);
        Some([best.room, rival.or_else(|| self.unasked(&best))?])
    }

    /// Whether two claims put the camera at one place.
    fn agree(&self, a: &Claim, b: &Claim) -> bool {
        let in_place = |claim: &Claim| self.cam_from_place(claim.room, &claim.cam_from_room);
        let (Some(a), Some(b)) = (in_place(a), in_place(b)) else {
            return false;
        };
        let (distance, angle) = a.error_to(&b);
        distance < SAME_POSITION && angle < SAME_TURN_RAD
    }

    fn cam_from_place(&self, room: usize, cam_from_room: &CamFromWorld) -> Option<CamFromWorld> {
        let placed = self.manifest.rooms.get(room)?.place_from_room?;
        Some(placed.cam_from_place(cam_from_room))
    }

    /// Solves the observed frame in a room that is at hand.
    fn solve_in(
        &mut self,
        room: usize,
        observed: &Observed,
        query: &Query,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Report, PlaceError> {
        self.take_up(room)?;
        let relocalizer = self.session.relocalizer_mut();
        // Which way gravity points in a room's world is known to its scene, where it is known.
        let down = relocalizer.scene_info().gravity;
        let gravity = query.gravity.zip(down);
        let query = Query {
            gravity: gravity.map(|(gravity, in_world)| Gravity {
                in_world,
                ..gravity
            }),
            ..*query
        };
        let report = relocalizer.solve(observed.clone(), &query, clock);
        Ok(report.map_err(SessionError::from)?)
    }

    /// Hands a room's scene to the relocalizer.
    fn take_up(&mut self, room: usize) -> Result<(), PlaceError> {
        if self.in_use == Some(room) {
            return Ok(());
        }
        self.put_back()?;
        if let Some(Some(held)) = self.rooms.get_mut(room) {
            self.session.relocalizer_mut().exchange(&mut held.scene)?;
            held.last_used = self.num_frames;
            self.in_use = Some(room);
        }
        Ok(())
    }

    /// Takes the scene in use back from the relocalizer.
    fn put_back(&mut self) -> Result<(), PlaceError> {
        if let Some(room) = self.in_use.take()
            && let Some(Some(held)) = self.rooms.get_mut(room)
        {
            self.session.relocalizer_mut().exchange(&mut held.scene)?;
        }
        Ok(())
    }

    fn stay(
        &mut self,
        room: usize,
        report: Report,
        query: &SessionQuery<'_>,
        num_solved: usize,
    ) -> PlaceReport {
        if let Some(Some(held)) = self.rooms.get_mut(room) {
            held.last_used = self.num_frames;
        }
        let session = self.session.follow(report, query);
        let located = session.frame.outcome.located();
        PlaceReport {
            session,
            room: located.map(|_| room),
            rival: None,
            has_entered: false,
            cam_from_place: located.and_then(|l| self.cam_from_place(room, &l.cam_from_world)),
            num_solved,
        }
    }

    fn enter(
        &mut self,
        room: usize,
        report: Report,
        query: &SessionQuery<'_>,
        num_solved: usize,
    ) -> PlaceReport {
        let has_entered = self.current != Some(room);
        if has_entered {
            self.current = Some(room);
            self.session.scene_changed();
        }
        PlaceReport {
            has_entered,
            ..self.stay(room, report, query, num_solved)
        }
    }

    fn nowhere(
        &mut self,
        report: Report,
        query: &SessionQuery<'_>,
        num_solved: usize,
    ) -> PlaceReport {
        PlaceReport {
            session: self.session.follow(report, query),
            room: None,
            rival: None,
            has_entered: false,
            cam_from_place: None,
            num_solved,
        }
    }

    /// The last report as that of a frame whose room is not known: for `reason` where it had an answer.
    fn refused(
        &mut self,
        last: Option<(usize, Report)>,
        observed: &Observed,
        reason: NotLocated,
        query: &Query,
        clock: &mut dyn FnMut() -> f64,
    ) -> Result<Report, PlaceError> {
        let mut report = match last {
            Some((_, report)) => report,
            // No room is at hand: what was seen is told, and that it was found nowhere.
            None => {
                self.put_back()?;
                let relocalizer = self.session.relocalizer_mut();
                let report = relocalizer.solve(observed.clone(), query, clock);
                report.map_err(SessionError::from)?
            }
        };
        if report.outcome.located().is_some() {
            report.outcome = Outcome::NotLocated(reason);
        }
        Ok(report)
    }
}
