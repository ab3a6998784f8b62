//! Which room: a frame's keypoints vote for the rooms that have a landmark like them.
//!
//! A room is some of its landmarks' codes, sorted by word. A keypoint looks among those of its own word, and gives each room a
//! share of its vote by how few bits the nearest one differs in: nearest neighbours vote for classes as in `[nbnn2008]`. What is in
//! many rooms, a window for one, is shared among them and tells little.

use super::PlaceError;
use super::words::{NUM_NODES, NUM_WORDS, Words};
use crate::features::FeatureSet;
use crate::landmarks::code::{CODE_BITS, SignCode, decode, signs};
use crate::math::elementary::ln;
use crate::math::order::sort_by;
use crate::nn::{WeightTensor, Weights};
use crate::scene_file::{
    Element, RawTensor, SceneFile, SceneFileError, TensorFile, serialize_with,
};
use std::collections::BTreeMap;

/// Version of index files. Another one is refused: an index is made anew of its scenes.
pub const INDEX_VERSION: u32 = 2;
/// Kind of file, as its metadata say.
const KIND: &str = "place-index";
const CENTRES: &str = "place.centres";
const MEAN: &str = "place.mean";
const COUNTS: &str = "landmark.counts";
const CODES: &str = "landmark.codes";

/// Landmarks of a room that are kept: fifty rooms are 0.43 MB then.
const LANDMARKS: usize = 1024;
/// Share of a vote that is left for each bit in which two codes differ. From 0.3 to 0.7 the ranking hardly changes.
const EACH_BIT: f32 = 0.5;
/// Bits in which codes of unlike things of one word differ: what no room is nearer than counts for none of them.
const UNLIKE_BITS: usize = 20;

/// How well a room explains a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoomScore {
    /// Its place among the rooms.
    pub room: usize,
    /// Natural logarithm of its share of the keypoints' votes.
    pub score: f32,
}

/// What is known of all rooms of a place at once.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaceIndex {
    code: SignCode,
    words: Words,
    rooms: Vec<String>,
    looks: Vec<Looks>,
}

/// What a room looks like: codes of landmarks, those of a word together.
#[derive(Debug, Clone, PartialEq, Default)]
struct Looks {
    /// Where the codes of each word end.
    ends: Vec<u16>,
    codes: Vec<u64>,
}

impl Looks {
    /// Of codes with their words.
    fn new(codes: impl Iterator<Item = (usize, u64)> + Clone) -> Self {
        let mut looks = Self::default();
        for word in 0..NUM_WORDS {
            let own = codes.clone().filter(|(of, _)| *of == word);
            // As many as a byte counts in the file.
            looks
                .codes
                .extend(own.map(|(_, code)| code).take(usize::from(u8::MAX)));
            looks.ends.push(looks.codes.len() as u16);
        }
        looks
    }

    fn of_word(&self, word: usize) -> &[u64] {
        let end = |word: usize| self.ends.get(word).map_or(0, |end| usize::from(*end));
        let start = word.checked_sub(1).map_or(0, end);
        self.codes.get(start..end(word)).unwrap_or(&[])
    }
}

/// Descriptors of a room's landmarks as a scene tells them, rows of as many numbers as a descriptor has; of a scene without, what
/// its codes stand for.
fn descriptors(id: &str, scene: &SceneFile) -> Result<Vec<f32>, PlaceError> {
    let channels = scene.config.descriptor_channels();
    let rows = match (scene.weights.get("point.anchor.keys"), &scene.landmarks) {
        (Some(keys), _) => keys.to_f32(),
        (None, Some(table)) => {
            let mean = &table.point_code.mean;
            let row = |code: &u64| {
                let numbers = decode(*code);
                let row = mean.iter().zip(numbers.iter().cycle());
                row.map(|(m, s)| m + s).collect::<Vec<f32>>()
            };
            table.point_codes.iter().flat_map(row).collect()
        }
        (None, None) => {
            return Err(PlaceError::NoLandmarks {
                room: id.to_owned(),
            });
        }
    };
    let num = rows.len() / channels.max(1);
    let kept = num.min(LANDMARKS);
    let even = (0..kept).map(|i| i * num / kept * channels);
    let mut out = Vec::with_capacity(kept * channels);
    for row in even.filter_map(|start| rows.get(start..start + channels)) {
        // The stored length of a key means nothing.
        let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
        out.extend(row.iter().map(|v| v / norm));
    }
    Ok(out)
}

impl PlaceIndex {
    /// Learns words from the landmarks of some rooms and what each room holds of them. Rooms are named as in the manifest.
    ///
    /// # Errors
    /// [`PlaceError::NoLandmarks`]; [`PlaceError::Rooms`] without any.
    pub fn build(rooms: &[(&str, &SceneFile)]) -> Result<Self, PlaceError> {
        let Some((_, first)) = rooms.first() else {
            return Err(PlaceError::Rooms {
                found: 0,
                limit: super::manifest::MAX_ROOMS,
            });
        };
        let channels = first.config.descriptor_channels();
        let all: Vec<Vec<f32>> = rooms
            .iter()
            .map(|(id, scene)| descriptors(id, scene))
            .collect::<Result<_, _>>()?;
        let rows = || all.iter().flat_map(|own| own.chunks_exact(channels));
        let code = SignCode::of(channels, rows());
        let queries: Vec<_> = rows().map(|row| code.query_of(row)).collect();
        let mut index = Self {
            words: Words::learn(&queries),
            code,
            rooms: Vec::new(),
            looks: Vec::new(),
        };
        for ((id, _), own) in rooms.iter().zip(&all) {
            index.put(id, own);
        }
        Ok(index)
    }

    /// Adds a room, or replaces what is known of it. The words stay, and so do the other rooms.
    ///
    /// # Errors
    /// [`PlaceError::NoLandmarks`].
    pub fn add(&mut self, id: &str, scene: &SceneFile) -> Result<(), PlaceError> {
        let own = descriptors(id, scene)?;
        self.put(id, &own);
        Ok(())
    }

    /// Forgets a room; true when there was one.
    pub fn remove(&mut self, id: &str) -> bool {
        let Some(at) = self.rooms.iter().position(|r| r == id) else {
            return false;
        };
        self.rooms.remove(at);
        self.looks.remove(at);
        true
    }

    /// Sets what a room looks like from its descriptors.
    fn put(&mut self, id: &str, own: &[f32]) {
        let rows = own.chunks_exact(self.code.mean.len().max(1));
        let codes: Vec<(usize, u64)> = rows
            .map(|row| {
                let query = self.code.query_of(row);
                (self.words.of(&query), signs(&query))
            })
            .collect();
        let looks = Looks::new(codes.iter().copied());
        match self.rooms.iter().position(|r| r == id) {
            Some(at) => self.looks[at] = looks,
            None => {
                self.rooms.push(id.to_owned());
                self.looks.push(looks);
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
        let is_other = channels == 0 || channels != self.code.mean.len();
        if is_other || out.is_empty() || features.descriptors_nd.is_empty() {
            return;
        }
        let mut weights = [1.0_f32; CODE_BITS + 1];
        for bits in 1..=CODE_BITS {
            weights[bits] = EACH_BIT * weights[bits - 1];
        }
        let rows = features.descriptors_nd.chunks_exact(channels);
        let num = rows.len().max(1);
        let mut votes = vec![0.0; out.len()];
        for row in rows {
            let query = self.code.query_of(row);
            let (word, own) = (self.words.of(&query), signs(&query));
            let mut all = weights[UNLIKE_BITS];
            for (vote, looks) in votes.iter_mut().zip(&self.looks) {
                let bits = looks.of_word(word).iter().map(|c| (c ^ own).count_ones());
                *vote = bits.min().map_or(0.0, |bits| weights[bits as usize]);
                all += *vote;
            }
            for (room, vote) in out.iter_mut().zip(&votes) {
                room.score += vote / all;
            }
        }
        for room in out.iter_mut() {
            room.score = ln(f64::from(room.score) / num as f64 + 1e-6) as f32;
        }
        best_first(out);
    }

    /// The bytes of a file: a safetensors file.
    ///
    /// # Errors
    /// [`PlaceError::Index`] when a number is not finite.
    pub fn to_bytes(&self) -> Result<Vec<u8>, PlaceError> {
        let num = self.rooms.len();
        let mut weights = Weights::new();
        for (name, shape, numbers) in [
            (CENTRES, vec![NUM_NODES, CODE_BITS], self.words.to_numbers()),
            (MEAN, vec![self.code.mean.len()], self.code.mean.clone()),
        ] {
            let tensor = WeightTensor::f32(&shape, numbers);
            weights.insert(name, tensor.map_err(|e| damaged(e.to_string()))?);
        }
        let counts = self.looks.iter().flat_map(|looks| {
            let count = |word| looks.of_word(word).len() as u8;
            (0..NUM_WORDS).map(count)
        });
        let codes = self.looks.iter().flat_map(|looks| &looks.codes);
        let codes: Vec<u8> = codes.flat_map(|c| c.to_le_bytes()).collect();
        let raw = |name, shape: [usize; 2], bytes| RawTensor {
            name,
            dtype: "U8",
            shape: shape.to_vec(),
            bytes,
        };
        let raw = vec![
            raw(COUNTS, [num, NUM_WORDS], counts.collect()),
            raw(CODES, [codes.len() / 8, 8], codes),
        ];
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
            CENTRES => Element::EIGHT_BIT,
            _ => Element::F32,
        };
        serialize_with(&metadata, &weights, raw, element).map_err(PlaceError::Index)
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
        let centres = take(CENTRES, &[NUM_NODES, CODE_BITS])?;
        let unlike = || damaged("counts that differ".to_owned());
        let words = Words::from_centres(&centres).ok_or_else(unlike)?;
        let raw = |name, columns| {
            file.raw(name, "U8", Some(columns))
                .map_err(PlaceError::Index)
        };
        let mut codes = raw(CODES, 8)?.as_chunks::<8>().0;
        let mut looks = Vec::with_capacity(rooms.len());
        for counts in raw(COUNTS, NUM_WORDS)?.chunks_exact(NUM_WORDS) {
            let mut end = 0;
            let ends = counts.iter().map(|count| {
                end += u16::from(*count);
                end
            });
            let ends: Vec<u16> = ends.collect();
            let Some((own, rest)) = codes.split_at_checked(usize::from(end)) else {
                break;
            };
            codes = rest;
            let codes = own.iter().map(|c| u64::from_le_bytes(*c)).collect();
            looks.push(Looks { ends, codes });
        }
        if looks.len() != rooms.len() || !codes.is_empty() {
            return Err(unlike());
        }
        Ok(Self {
            code: SignCode { mean },
            words,
            rooms,
            looks,
        })
    }
}

fn damaged(reason: String) -> PlaceError {
    PlaceError::Index(SceneFileError::Header { reason })
}

/// Orders rooms by score, equal ones by their place in the manifest.
pub(super) fn best_first(rooms: &mut [RoomScore]) {
    sort_by(rooms, |a, b| {
        b.score.total_cmp(&a.score).then(a.room.cmp(&b.room))
    });
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
        let newer = change("\"format\":\"2\"", "\"format\":\"3\"");
        assert!(matches!(
            newer,
            PlaceError::Index(SceneFileError::Version { .. })
        ));
        let other = change("place-index", "place-under");
        assert!(matches!(
            other,
            PlaceError::Index(SceneFileError::Kind { .. })
        ));
        change("place.mean", "place.none");
        change("landmark.codes", "landmark.other");
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
