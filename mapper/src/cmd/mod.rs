//! The commands of the tool, one file each: `Args` for clap and `run`. Keep alphabetical.

pub mod convert;
pub mod data;
pub mod demo;
pub mod eval;
pub mod export;
pub mod features;
pub mod flow;
pub mod inspect;
pub mod labels;
pub mod landmarks;
pub mod lines;
pub mod locate;
pub mod map;
pub mod pose;
pub mod poses;
pub mod track;
#[cfg(feature = "train")]
pub mod train;

use crate::shown::shown;

/// What went wrong, outermost first and in one line; a cause that the text before it already ends with is not told again.
pub fn told(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(|c| shown(&c.to_string()).into_owned()) {
        if text.ends_with(&cause) {
            continue;
        }
        if !text.is_empty() {
            text.push_str(": ");
        }
        text.push_str(&cause);
    }
    text
}

#[cfg(test)]
mod tests {
    use anyhow::Context as _;

    #[derive(Debug, thiserror::Error)]
    #[error("writing room.landline: {source}")]
    struct Write {
        source: std::io::Error,
    }

    #[test]
    fn causes_are_told_once() {
        let source = std::io::Error::other("disk full");
        let error = Err::<(), _>(Write { source }).context("training");
        let error = error.expect_err("an error");
        assert_eq!(
            super::told(&error),
            "training: writing room.landline: disk full"
        );
    }
}
