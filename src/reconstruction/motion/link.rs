//! Where a model hangs together least.

use crate::reconstruction::PointTrack;

/// So many pictures at either end are not judged: where a film begins and ends few points lie on the far side.
const JUDGED_FROM: usize = 8;
/// Fewer points do not hold two parts of a film to one scale. In half of a headset's film the scale went from 1.33 to 1.05 times
/// the true one between two places of 57 and 71 points; places of 103 and more kept theirs, in three rooms. One of 68, where the
/// camera changed its zoom, did too: it is a warning, not a verdict.
const FEW: usize = 100;

/// Two neighbouring pictures between which a model hangs together by few points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WeakLink {
    /// The last picture before the place.
    pub before: usize,
    /// The first one behind it.
    pub after: usize,
    /// Points that at least two pictures see on either side, so that both sides alone say how far away they are.
    pub num_points: usize,
}

impl WeakLink {
    /// The place that the fewest points span, if they are few. `pictures` are those with a pose, in the order in which they were
    /// taken, as the observations of `points` name them; those of a point ascend.
    pub(super) fn weakest(points: &[PointTrack], pictures: &[usize]) -> Option<Self> {
        let num = pictures.last()? + 1;
        // Where the number of points that span begins and ends to be larger.
        let mut steps = vec![0_i64; num + 1];
        for point in points {
            let seen = &point.observations;
            let [_, second, .., before_last, _] = seen.as_slice() else {
                continue;
            };
            steps[second.view as usize + 1] += 1;
            steps[before_last.view as usize + 1] -= 1;
        }
        let spanning: Vec<i64> = steps
            .iter()
            .scan(0, |sum, step| {
                *sum += step;
                Some(*sum)
            })
            .collect();
        let judged = pictures.get(JUDGED_FROM - 1..pictures.len().checked_sub(JUDGED_FROM - 1)?)?;
        let links = judged.windows(2).map(|pair| Self {
            before: pair[0],
            after: pair[1],
            num_points: spanning[pair[1]] as usize,
        });
        links
            .min_by_key(|link| link.num_points)
            .filter(|link| link.num_points < FEW)
    }

    /// What it means and what helps, for people, with the names of the two pictures.
    pub fn message(&self, before: &str, after: &str) -> String {
        format!(
            "Only {} points hold together what was filmed up to {before} and from {after} on: the two may differ in scale. Film the \
             way between them again, slower, walking sideways.",
            self.num_points
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruction::Observation;
    use nalgebra::Vector3;

    fn point(views: &[usize]) -> PointTrack {
        let observations = views.iter().map(|v| Observation::new(*v, 0));
        PointTrack::new(Vector3::zeros(), observations.collect())
    }

    #[test]
    fn the_place_that_fewest_points_span_is_named_where_they_are_few() {
        // Pictures 7 and 21 have no pose; 60 points span any two neighbours but 15 and 16, which 40 span.
        let pictures: Vec<usize> = (0..40).filter(|i| ![7, 21].contains(i)).collect();
        let mut points = Vec::new();
        for _ in 0..20 {
            points.push(point(&[0, 1, 38, 39]));
            points.push(point(&[0, 1, 14, 17, 38, 39]));
            points.push(point(&[0, 1, 15, 16]));
            points.push(point(&[15, 16, 38, 39]));
        }
        // Seen once on one side: neither holds the other.
        points.extend((0..500).map(|_| point(&[14, 15, 16])));
        let link = WeakLink::weakest(&points, &pictures);
        let expected = WeakLink {
            before: 15,
            after: 16,
            num_points: 40,
        };
        assert_eq!(link, Some(expected));
        let words = expected.message("a.jpg", "b.jpg");
        assert!(
            words.contains("40 points") && words.contains("a.jpg"),
            "{words}"
        );

        points.extend((0..60).map(|_| point(&[2, 3, 38, 39])));
        assert_eq!(WeakLink::weakest(&points, &pictures), None);
        assert_eq!(WeakLink::weakest(&[], &pictures[..12]), None);
        assert_eq!(WeakLink::weakest(&[], &[]), None);
    }
}
