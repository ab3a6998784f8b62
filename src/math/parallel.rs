//! One loop over independent items, on several threads where the feature `parallel` is on.
//!
//! Results come in the order of the items and do not depend on the number of threads.

/// `work(0), .., work(count - 1)`.
pub fn map<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    map_with(count, || (), |(), i| work(i))
}

/// [`map`] with working room that `room` makes, one for each thread or piece of work.
pub fn map_with<R, T: Send>(
    count: usize,
    room: impl Fn() -> R + Sync + Send,
    work: impl Fn(&mut R, usize) -> T + Sync + Send,
) -> Vec<T> {
    #[cfg(all(feature = "parallel", not(target_arch = "wasm32")))]
    {
        use rayon::prelude::*;
        (0..count).into_par_iter().map_init(room, work).collect()
    }
    #[cfg(not(all(feature = "parallel", not(target_arch = "wasm32"))))]
    {
        let mut room = room();
        (0..count).map(|i| work(&mut room, i)).collect()
    }
}

/// `work` of the number and the values of each piece of `len` values, in the order of the pieces.
pub fn map_chunks<V: Send, T: Send>(
    values: &mut [V],
    len: usize,
    work: impl Fn(usize, &mut [V]) -> T + Sync + Send,
) -> Vec<T> {
    let len = len.max(1);
    #[cfg(all(feature = "parallel", not(target_arch = "wasm32")))]
    {
        use rayon::prelude::*;
        values
            .par_chunks_mut(len)
            .enumerate()
            .map(|(i, chunk)| work(i, chunk))
            .collect()
    }
    #[cfg(not(all(feature = "parallel", not(target_arch = "wasm32"))))]
    {
        values
            .chunks_mut(len)
            .enumerate()
            .map(|(i, chunk)| work(i, chunk))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn results_are_in_the_order_of_the_items() {
        let squares = super::map_with(
            1000,
            || 0usize,
            |calls, i| {
                *calls += 1;
                i * i
            },
        );
        assert!(squares.iter().enumerate().all(|(i, s)| *s == i * i));
        assert!(super::map(0, |i| i).is_empty());
        let mut values = [1, 2, 3, 4, 5];
        let sums = super::map_chunks(&mut values, 2, |i, chunk| {
            chunk[0] += 10 * i;
            chunk.iter().sum::<usize>()
        });
        assert_eq!((sums, values), (vec![3, 17, 25], [1, 2, 13, 4, 25]));
    }
}
