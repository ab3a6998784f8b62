//! Lengths for people: centimetres where the world is in metres, "units" where nobody knows what one is.

use landline::scene_file::{HeldOut, Units};

/// How lengths of a world are told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ruler {
    /// Told lengths are world lengths times this.
    pub factor: f64,
    /// What stands behind them.
    pub symbol: &'static str,
    /// Digits behind the point that a millimetre of a metric room needs.
    pub digits: usize,
}

impl Ruler {
    /// Of a world's unit.
    pub fn of(units: Units) -> Self {
        match units {
            Units::Metres => Self {
                factor: 100.0,
                symbol: "cm",
                digits: 2,
            },
            Units::Arbitrary => Self {
                factor: 1.0,
                symbol: units.symbol(),
                digits: 4,
            },
        }
    }

    /// A world length without what stands behind it.
    pub fn number(&self, length: f64) -> String {
        format!("{:.*}", self.digits, self.factor * length)
    }

    /// A world length.
    pub fn text(&self, length: f64) -> String {
        format!("{} {}", self.number(length), self.symbol)
    }

    /// A threshold in world lengths, without digits that say nothing.
    pub fn threshold(&self, length: f64) -> String {
        // A hundred times a hundredth is not one.
        format!("{}", (self.factor * length * 1e9).round() / 1e9)
    }
}

/// Accuracy on held-out pictures, in a few words.
pub fn accuracy(held_out: &HeldOut, units: Units) -> String {
    let ruler = Ruler::of(units);
    let median = match (held_out.median_position, held_out.median_rotation_deg) {
        (Some(position), Some(deg)) => format!("median {} / {deg:.3} deg", ruler.text(position)),
        _ => "no median, too few located".to_owned(),
    };
    let recall = held_out.recall_5cm_5deg.map_or(String::new(), |share| {
        format!(", {:.1} % within 5 cm and 5 deg", 100.0 * share)
    });
    format!(
        "{median}{recall}, {} of {} pictures not located",
        held_out.num_not_located, held_out.num_images
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centimetres_only_where_metres_are_known() {
        let metric = Ruler::of(Units::Metres);
        assert_eq!(metric.text(0.01234), "1.23 cm");
        assert_eq!(metric.threshold(0.07), "7");
        let unknown = Ruler::of(Units::Arbitrary);
        assert_eq!(unknown.text(0.01234), "0.0123 units");
        assert_eq!(unknown.threshold(0.02), "0.02");
    }

    #[test]
    fn accuracy_says_centimetres_only_where_metres_are_known() {
        let errors = [Some((0.012, 0.5)), Some((0.034, 1.0)), None];
        let told = |units| accuracy(&HeldOut::of(&errors, units), units);
        assert_eq!(
            told(Units::Metres),
            "median 3.40 cm / 1.000 deg, 66.7 % within 5 cm and 5 deg, 1 of 3 pictures not located"
        );
        assert_eq!(
            told(Units::Arbitrary),
            "median 0.0340 units / 1.000 deg, 1 of 3 pictures not located"
        );
        let lost = HeldOut::of(&[None, None], Units::Arbitrary);
        assert_eq!(
            accuracy(&lost, Units::Arbitrary),
            "no median, too few located, 2 of 2 pictures not located"
        );
    }
}
