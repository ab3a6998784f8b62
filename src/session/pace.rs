//! What is far and fast in a scene whose units may be anything.

use crate::scene_file::{SceneInfo, Units};

/// The usual [`SceneScale::scale`](crate::geometry::SceneScale) of a room in metres: half its landmarks are nearer to its
/// middle than this.
const USUAL_SCALE_M: f64 = 2.0;

/// World units that are taken for a metre where thresholds of movement are meant. Exactly one in a metric scene. Where units
/// are arbitrary, the scene is taken to be as large as a usual room: thresholds of movement are wide enough for that.
pub(super) fn metre(info: &SceneInfo) -> f64 {
    match info.units {
        Units::Metres => 1.0,
        Units::Arbitrary => info.scale.scale / USUAL_SCALE_M,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::ExtractorKind;

    #[test]
    fn follows_the_scale_where_units_are_arbitrary() {
        let mut info = SceneInfo::new(ExtractorKind::Xfeat, "");
        info.scale.scale = 300.0;
        assert_eq!(metre(&info), 150.0, "units are arbitrary unless known");
        info.units = Units::Metres;
        assert_eq!(metre(&info), 1.0);
    }
}
