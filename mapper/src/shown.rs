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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_steers_a_terminal_is_escaped_and_nothing_else() {
        assert_eq!(shown("küche/IMG  1 (2).jpg 机"), "küche/IMG  1 (2).jpg 机");
        assert_eq!(
            shown("a\u{1b}[2J\r\nb\t\u{9b}31m\u{202e}gpj"),
            "a\\u{1b}[2J\\r\\nb\\t\\u{9b}31m\\u{202e}gpj"
        );
    }
}
