//! Which room: the likelihood of a frame's words in each room.
//!
//! A room's landmarks say which words its pictures hold. The score of a room is the mean, over a frame's keypoints, of the
//! logarithm of how much more likely their words are in that room than anywhere: naive Bayes on visual words, as `[fabmap2008]`
//! without its dependencies.

use super::PlaceError;
use super::words::{NUM_NODES, NUM_WORDS, Query, Words};
use crate::features::FeatureSet;
use crate::landmarks::code::{CODE_BITS, SignCode, decode};
use crate::math::elementary::ln;
use crate::nn::{WeightTensor, Weights};
use crate::scene_file::{Element, SceneFile, SceneFileError, TensorFile, serialize};
use std::collections::BTreeMap;

/// Version of index files. A newer one is refused.
pub const INDEX_VERSION: u32 = 1;
/// Kind of file, as its metadata say.
const KIND: &str = "place-index";
const CENTRES: &str = "place.centres";
const ROOMS: &str = "place.rooms";
const MEAN: &str = "place.mean";
const USUAL: &str = "place.usual";

/// Keypoints that are looked up; of more, evenly many.
const MOST_KEYPOINTS: usize = 512;
/// Share of a room's pictures that its landmarks do not tell.
const UNTOLD: f64 = 0.5;
/// Share of a landmark that goes to its nearest word; the rest goes to the second.
const FIRST_WORD: f64 = 0.7;
/// Weight of a landmark that is known by its code alone, beside one of which the descriptor is known.
const CODE_WEIGHT: f64 = 0.25;
/// Weight of the even distribution in that of all rooms.
const EVEN: f64 = 0.3;
/// Most descriptors that words are learned from.
const MOST_ROWS: usize = 40_000;

/// How well a room explains a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoomScore {
    /// Its place among the rooms.
    pub room: usize,
    /// Nats for each keypoint above what is usual.
    pub score: f32,
}

/// What is known of all rooms of a place at once.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaceIndex {
    code: SignCode,
    words: Words,
    /// How likely each word is in any room.
    usual: Vec<f32>,
    rooms: Vec<String>,
    /// `[words, rooms]`.
    log_ratios: Vec<f32>,
}

/// What a room looks like, as its scene tells.
struct Looks {
    /// Unit rows of as many numbers as a descriptor has.
    descriptors: Vec<f32>,
    /// Of the codes.
    mean: Vec<f32>,
    codes: Vec<u64>,
}

impl Looks {
    fn of(id: &str, scene: &SceneFile) -> Result<Self, PlaceError> {
        let keys = scene.weights.get("point.anchor.keys");
        let table = scene.landmarks.as_ref();
        if keys.is_none() && table.is_none() {
            return Err(PlaceError::NoLandmarks {
                room: id.to_owned(),
            });
        }
        let channels = scene.config.descriptor_channels();
        let mut descriptors = keys.map(WeightTensor::to_f32).unwrap_or_default();
        // The stored length of a key means nothing.
        for row in descriptors.chunks_exact_mut(channels) {
            let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
            row.iter_mut().for_each(|v| *v /= norm);
        }
        let mean = match table {
            Some(table) => table.point_code.mean.clone(),
            None => SignCode::of(channels, descriptors.chunks_exact(channels)).mean,
        };
        Ok(Self {
            descriptors,
            mean,
            codes: table.map_or_else(Vec::new, |t| t.point_codes.clone()),
        })
    }

    /// Descriptors as they are compared, each with its weight.
    fn queries<'a>(&'a self, code: &'a SignCode) -> impl Iterator<Item = (Query, f64)> + 'a {
        let channels = code.mean.len().max(1);
        let known = self.descriptors.chunks_exact(channels).map(|row| {
            let mut query = [0.0; CODE_BITS];
            code.query(row, &mut query);
            (query, 1.0)
        });
        // Codes count from the room's own mean, which is near the place's.
        known.chain(self.codes.iter().map(|c| (decode(*c), CODE_WEIGHT)))
    }
}

impl PlaceIndex {
    /// Learns words from the landmarks of some rooms and what each room holds of them. Rooms are named as in the manifest.
    ///
    /// # Errors
    /// [`PlaceError::NoLandmarks`]; [`PlaceError::Rooms`] without any.
    pub fn build(rooms: &[(&str, &SceneFile)]) -> Result<Self, PlaceError> {
        let looks: Vec<Looks> = rooms
            .iter()
            .map(|(id, scene)| Looks::of(id, scene))
            .collect::<Result<_, _>>()?;
        let Some(first) = looks.first() else {
            return Err(PlaceError::Rooms {
                found: 0,
                limit: super::manifest::MAX_ROOMS,
            });
        };
        let channels = first.mean.len();
        let means = looks.iter().map(|l| l.mean.as_slice());
        let code = SignCode::of(channels, means);
        let told = |l: &Looks| -> Vec<Query> { l.queries(&code).map(|(q, _)| q).collect() };
        let all: Vec<Vec<Query>> = looks.iter().map(told).collect();
        let each = (MOST_ROWS / all.len().max(1)).max(1);
        let rows: Vec<Query> = all
            .iter()
            .flat_map(|own| own.iter().step_by(own.len().div_ceil(each).max(1)))
            .copied()
            .collect();
        let words = Words::learn(&rows);
        let counts: Vec<Vec<f64>> = looks.iter().map(|l| shares(&words, &code, l)).collect();
        let mut usual = vec![EVEN / NUM_WORDS as f64; NUM_WORDS];
        for own in &counts {
            for (u, c) in usual.iter_mut().zip(own) {
                *u += (1.0 - EVEN) * c / counts.len() as f64;
            }
        }
        let mut index = Self {
            code,
            words,
            usual: usual.iter().map(|u| *u as f32).collect(),
            rooms: Vec::new(),
            log_ratios: Vec::new(),
        };
        for ((id, _), own) in rooms.iter().zip(&counts) {
            index.put(id, own);
        }
        Ok(index)
    }

    /// Adds a room, or replaces what is known of it. The words stay, and so do the other rooms.
    ///
    /// # Errors
    /// [`PlaceError::NoLandmarks`].
    pub fn add(&mut self, id: &str, scene: &SceneFile) -> Result<(), PlaceError> {
        let looks = Looks::of(id, scene)?;
        let own = shares(&self.words, &self.code, &looks);
        self.put(id, &own);
        Ok(())
    }

    /// Forgets a room; true when there was one.
    pub fn remove(&mut self, id: &str) -> bool {
        let Some(at) = self.rooms.iter().position(|r| r == id) else {
            return false;
        };
        let num = self.rooms.len();
        let mut column = (0..num).cycle();
        self.log_ratios.retain(|_| column.next() != Some(at));
        self.rooms.remove(at);
        true
    }

    /// Sets a room's column from its shares of the words.
    fn put(&mut self, id: &str, own: &[f64]) {
        let ratios = own.iter().zip(&self.usual).map(|(own, usual)| {
            let usual = f64::from(*usual).max(1e-9);
            ln(((1.0 - UNTOLD) * own + UNTOLD * usual) / usual) as f32
        });
        let ratios: Vec<f32> = ratios.collect();
        let num = self.rooms.len();
        match self.rooms.iter().position(|r| r == id) {
            Some(at) => {
                let cells = self.log_ratios.iter_mut().skip(at).step_by(num);
                cells.zip(&ratios).for_each(|(cell, ratio)| *cell = *ratio);
            }
            None => {
                let before = core::mem::take(&mut self.log_ratios);
                for (word, ratio) in ratios.iter().enumerate() {
                    let row = before.get(word * num..(word + 1) * num).unwrap_or(&[]);
                    self.log_ratios.extend_from_slice(row);
                    self.log_ratios.push(*ratio);
                }
                self.rooms.push(id.to_owned());
            }
        }
    }

    /// Names of the rooms, in the order of [`RoomScore::room`].
    pub fn rooms(&self) -> &[String] {
        &self.rooms
    }

    /// Fills `out` with all rooms, the likeliest first.
    pub fn rank(&self, features: &FeatureSet, out: &mut Vec<RoomScore>) {
        out.clear();
        out.extend((0..self.rooms.len()).map(|room| RoomScore { room, score: 0.0 }));
        let channels = features.descriptor_channels;
        if channels == 0 || channels != self.code.mean.len() || out.is_empty() {
            return;
        }
        let rows = features.descriptors_nd.chunks_exact(channels);
        let step = rows.len().div_ceil(MOST_KEYPOINTS).max(1);
        let num = rows.len().div_ceil(step).max(1);
        let mut query = [0.0; CODE_BITS];
        for row in rows.step_by(step) {
            self.code.query(row, &mut query);
            let [word, _] = self.words.of(&query);
            let start = word * out.len();
            let ratios = self.log_ratios.get(start..start + out.len()).unwrap_or(&[]);
            for (room, ratio) in out.iter_mut().zip(ratios) {
                room.score += ratio;
            }
        }
        for room in out.iter_mut() {
            room.score /= num as f32;
        }
        best_first(out);
    }

    /// The bytes of a file: a safetensors file with 8-bit rows.
    ///
    /// # Errors
    /// [`PlaceError::Index`] when a number is not finite.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PlaceError> {
        let num = self.rooms.len();
        let by_room = (0..num).flat_map(|room| self.log_ratios.iter().skip(room).step_by(num));
        let tensors = [
            (CENTRES, vec![NUM_NODES, CODE_BITS], self.words.to_numbers()),
            (ROOMS, vec![num, NUM_WORDS], by_room.copied().collect()),
            (MEAN, vec![self.code.mean.len()], self.code.mean.clone()),
            (USUAL, vec![NUM_WORDS], self.usual.clone()),
        ];
        let mut weights = Weights::new();
        for (name, shape, numbers) in tensors {
            let tensor = WeightTensor::f32(&shape, numbers);
            weights.insert(name, tensor.map_err(|e| damaged(e.to_string()))?);
        }
        let names = serde_json::to_string(&self.rooms).map_err(|e| damaged(e.to_string()))?;
        let metadata: BTreeMap<String, String> = [
            ("landline", KIND.to_owned()),
            ("format", INDEX_VERSION.to_string()),
            ("rooms", names),
        ]
        .into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .collect();
        let element = |name: &str, _: &[usize]| match name {
            CENTRES | ROOMS => Element::EIGHT_BIT,
            _ => Element::F32,
        };
        serialize(&metadata, &weights, element).map_err(PlaceError::Index)
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`PlaceError::Index`] for everything that is not exactly an index of this version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, PlaceError> {
        let file = TensorFile::parse(bytes).map_err(PlaceError::Index)?;
        let text = |key| file.text(key).map_err(PlaceError::Index);
        let (kind, version) = (text("landline")?, text("format")?);
        if kind != KIND {
            return Err(PlaceError::Index(SceneFileError::Kind {
                found: kind.to_owned(),
                expected: KIND,
            }));
        }
        if version != INDEX_VERSION.to_string() {
            return Err(PlaceError::Index(SceneFileError::Version {
                found: version.to_owned(),
                supported: INDEX_VERSION,
            }));
        }
        let rooms: Vec<String> =
            serde_json::from_str(text("rooms")?).map_err(|e| damaged(e.to_string()))?;
        let mut weights = file.weights().map_err(PlaceError::Index)?;
        let mean_len = weights.get(MEAN).map_or(0, |t| t.shape().iter().product());
        let mut take = |name: &str, shape: &[usize]| {
            let taken = weights.take_f32(name, shape);
            taken.map_err(|e| damaged(e.to_string()))
        };
        let mean = take(MEAN, &[mean_len])?;
        let usual = take(USUAL, &[NUM_WORDS])?;
        let centres = take(CENTRES, &[NUM_NODES, CODE_BITS])?;
        let by_room = take(ROOMS, &[rooms.len(), NUM_WORDS])?;
        let words = Words::from_centres(&centres)
            .ok_or_else(|| damaged("another number of words, or one that is none".to_owned()))?;
        let log_ratios = (0..NUM_WORDS)
            .flat_map(|word| by_room.iter().skip(word).step_by(NUM_WORDS))
            .copied()
            .collect();
        Ok(Self {
            code: SignCode { mean },
            words,
            usual,
            rooms,
            log_ratios,
        })
    }
}

fn damaged(reason: String) -> PlaceError {
    PlaceError::Index(SceneFileError::Header { reason })
}

/// Share of each word in what a room holds.
fn shares(words: &Words, code: &SignCode, looks: &Looks) -> Vec<f64> {
    let mut counts = vec![0.0; NUM_WORDS];
    let mut total = 0.0;
    for (query, weight) in looks.queries(code) {
        let [first, second] = words.of(&query);
        for (word, share) in [(first, FIRST_WORD), (second, 1.0 - FIRST_WORD)] {
            if let Some(count) = counts.get_mut(word) {
                *count += weight * share;
            }
        }
        total += weight;
    }
    if total > 0.0 {
        counts.iter_mut().for_each(|c| *c /= total);
    }
    counts
}

/// Orders rooms by score, equal ones by their place in the manifest. An insertion: rooms are some dozens, and the library's
/// sort would be 9 kB of every page's engine for each place that calls it.
pub(super) fn best_first(rooms: &mut [RoomScore]) {
    let before = |a: &RoomScore, b: &RoomScore| {
        b.score
            .total_cmp(&a.score)
            .then(a.room.cmp(&b.room))
            .is_lt()
    };
    for end in 1..rooms.len() {
        let mut at = end;
        while at > 0 && before(&rooms[at], &rooms[at - 1]) {
            rooms.swap(at, at - 1);
            at -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;
    use crate::models::ExtractorKind;
    use crate::models::landmarks::{Anchor, untrained};
    use crate::scene_file::SceneInfo;

    const CHANNELS: usize = 64;

    fn rows(seed: u64, count: usize) -> Vec<Vec<f32>> {
        let mut rng = Rng::from_seed(seed);
        let row = |rng: &mut Rng| {
            let v: Vec<f32> = (0..CHANNELS).map(|_| rng.normal() as f32).collect();
            let norm = v.iter().map(|x| x * x).sum::<f32>().sqrt();
            v.into_iter().map(|x| x / norm).collect::<Vec<f32>>()
        };
        (0..count).map(|_| row(&mut rng)).collect()
    }

    fn scene(seed: u64) -> SceneFile {
        let anchors: Vec<Anchor> = rows(seed, 300)
            .into_iter()
            .map(|key| Anchor {
                key,
                value: vec![0.0; 3],
            })
            .collect();
        let (config, weights) = untrained(CHANNELS, &anchors, &[]).expect("fits");
        SceneFile {
            info: SceneInfo::new(ExtractorKind::Xfeat, "ab".repeat(32)),
            config,
            weights,
            landmarks: None,
        }
    }

    /// A frame of which one keypoint in three shows something of the room.
    fn frame(seed: u64) -> FeatureSet {
        let mut all = rows(seed, 300);
        all.truncate(100);
        all.extend(rows(seed + 1000, 200));
        FeatureSet {
            descriptors_nd: all.concat(),
            descriptor_channels: CHANNELS,
            ..FeatureSet::default()
        }
    }

    fn index(seeds: &[u64]) -> PlaceIndex {
        let scenes: Vec<(String, SceneFile)> = seeds
            .iter()
            .map(|s| (format!("room-{s}"), scene(*s)))
            .collect();
        let borrowed: Vec<(&str, &SceneFile)> =
            scenes.iter().map(|(id, s)| (id.as_str(), s)).collect();
        PlaceIndex::build(&borrowed).expect("builds")
    }

    fn first(index: &PlaceIndex, seed: u64) -> String {
        let mut ranking = Vec::new();
        index.rank(&frame(seed), &mut ranking);
        assert_eq!(ranking.len(), index.rooms().len());
        index.rooms()[ranking[0].room].clone()
    }

    #[test]
    fn a_frame_is_of_the_room_whose_landmarks_it_shows_also_from_a_file() {
        let index = index(&[1, 2, 3, 4, 5]);
        let bytes = index.to_bytes().expect("writes");
        assert_eq!(bytes, index.to_bytes().expect("writes"));
        let read = PlaceIndex::from_bytes(&bytes).expect("reads");
        for seed in 1..=5 {
            assert_eq!(first(&index, seed), format!("room-{seed}"));
            assert_eq!(first(&read, seed), format!("room-{seed}"));
        }
    }

    #[test]
    fn rooms_come_and_go_without_the_others() {
        let mut index = index(&[1, 2, 3]);
        let before = index.clone();
        index.add("room-9", &scene(9)).expect("adds");
        assert_eq!(first(&index, 9), "room-9");
        assert_eq!(first(&index, 2), "room-2");
        // Taught anew, under the name it had.
        index.add("room-2", &scene(7)).expect("replaces");
        assert_eq!(index.rooms().len(), 4);
        assert_eq!(first(&index, 7), "room-2");
        index.add("room-2", &scene(2)).expect("replaces");
        assert!(index.remove("room-9"));
        assert!(!index.remove("room-9"));
        assert_eq!(index, before);
    }

    #[test]
    fn fifty_rooms_take_less_than_half_a_megabyte() {
        let mut index = index(&[1]);
        for room in 1..53 {
            index.add(&format!("room-{room}"), &scene(1)).expect("adds");
        }
        let len = index.to_bytes().expect("writes").len();
        assert!(len <= 500_000, "{len} bytes");
    }

    #[test]
    fn damaged_and_foreign_files_are_refused() {
        let bytes = index(&[1, 2]).to_bytes().expect("writes");
        for len in [0, 7, 100, bytes.len() - 1] {
            assert!(PlaceIndex::from_bytes(&bytes[..len]).is_err(), "{len}");
        }
        let change = |from: &str, to: &str| {
            assert_eq!(from.len(), to.len());
            let at = bytes
                .windows(from.len())
                .position(|w| w == from.as_bytes())
                .expect("is there");
            let mut changed = bytes.clone();
            changed[at..at + to.len()].copy_from_slice(to.as_bytes());
            PlaceIndex::from_bytes(&changed).expect_err("must refuse")
        };
        let newer = change("\"format\":\"1\"", "\"format\":\"2\"");
        assert!(matches!(
            newer,
            PlaceError::Index(SceneFileError::Version { .. })
        ));
        let other = change("place-index", "place-under");
        assert!(matches!(
            other,
            PlaceError::Index(SceneFileError::Kind { .. })
        ));
        change("place.usual", "place.other");
    }

    #[test]
    fn a_frame_without_features_and_one_of_another_extractor_rank_nothing() {
        let index = index(&[1, 2]);
        let mut ranking = Vec::new();
        for channels in [0, 64, 256] {
            let features = FeatureSet {
                descriptor_channels: channels,
                ..FeatureSet::default()
            };
            index.rank(&features, &mut ranking);
            assert!(ranking.iter().all(|r| r.score == 0.0));
        }
    }
}
