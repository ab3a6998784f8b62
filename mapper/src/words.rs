//! Words of the command line for values whose types know no command line.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

/// A parser of these words, each with its value and its help.
pub fn words<T: Clone + Send + Sync + 'static, const N: usize>(
    all: [(&'static str, T, &'static str); N],
) -> impl TypedValueParser<Value = T> {
    let told = all
        .each_ref()
        .map(|(word, _, help)| PossibleValue::new(*word).help(*help));
    PossibleValuesParser::new(told).try_map(move |given| {
        let found = all.iter().find(|(word, ..)| *word == given);
        found
            .map(|(_, value, _)| value.clone())
            .ok_or("not one of them")
    })
}
