// Every target of this folder: `target!` with the name that the harness gives its parser.
macro_rules! target {
    ($name:literal) => {
        libfuzzer_sys::fuzz_target!(|data: &[u8]| {
            (landline_fuzz::target($name).run)(data);
        });

        // Half of the inputs by our own changes, which keep the structure; the other half by libFuzzer's.
        libfuzzer_sys::fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
            if seed % 2 == 0 {
                return libfuzzer_sys::fuzzer_mutate(data, size, max_size);
            }
            let changed = landline_fuzz::mutated(
                &data[..size],
                &mut landline::math::Rng::from_seed(u64::from(seed)),
            );
            let len = changed.len().min(max_size);
            data[..len].copy_from_slice(&changed[..len]);
            len
        });
    };
}
