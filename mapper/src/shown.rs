//! Text of files and file names as a terminal may show it.

use std::borrow::Cow;

/// Text with everything escaped that steers a terminal or changes the direction of writing, line ends too: what comes from
/// a file must not clear a screen, change a title or forge a line.
pub fn shown(text: &str) -> Cow<'_, str> {
    let steers = |c: char| {
        c.is_control()
            || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    if !text.contains(steers) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if steers(c) {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

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
    use super::*;
    use anyhow::Context as _;

    #[test]
    fn what_steers_a_terminal_is_escaped_and_nothing_else() {
        assert_eq!(shown("küche/IMG  1 (2).jpg 机"), "küche/IMG  1 (2).jpg 机");
        assert_eq!(
            shown("a\u{1b}[2J\r\nb\t\u{9b}31m\u{202e}gpj"),
            "a\\u{1b}[2J\\r\\nb\\t\\u{9b}31m\\u{202e}gpj"
        );
    }

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
        assert_eq!(told(&error), "training: writing room.landline: disk full");
    }
}
