//! What one unit of world length is.

/// Unit of world lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Units {
    /// Metres: the data set's format defines them, or the user said so.
    Metres,
    /// Unknown, as in a reconstruction without a known distance.
    #[default]
    Arbitrary,
}

impl Units {
    /// The word in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Metres => "m",
            Self::Arbitrary => "arbitrary",
        }
    }

    /// The unit of that [name](Self::name).
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Metres, Self::Arbitrary]
            .into_iter()
            .find(|units| units.name() == name)
    }

    /// What stands behind a length for people.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Metres => "m",
            Self::Arbitrary => "units",
        }
    }
}
