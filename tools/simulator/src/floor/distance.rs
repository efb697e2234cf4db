//! Exact Euclidean distance transform.

use super::raster::Frame;

const FAR: f32 = 1e12;

/// Distance from the middle of every open cell to the middle of the nearest closed one, cells; what is outside of the
/// frame is closed. Felzenszwalb and Huttenlocher, 2012, "Distance transforms of sampled functions".
pub(super) fn to_closed(open: &[bool], frame: &Frame) -> Vec<f32> {
    // A border of closed cells around the frame.
    let (width, height) = (frame.width + 2, frame.height + 2);
    let mut squared = vec![0.0; width * height];
    for row in 0..frame.height {
        for column in 0..frame.width {
            if open[row * frame.width + column] {
                squared[(row + 1) * width + column + 1] = FAR;
            }
        }
    }
    let mut line = Line::new(width.max(height));
    for column in 0..width {
        line.values.clear();
        line.values.extend((0..height).map(|row| squared[row * width + column]));
        line.transform();
        for row in 0..height {
            squared[row * width + column] = line.result[row];
        }
    }
    let mut distance = Vec::with_capacity(frame.cells());
    for row in squared.chunks(width).skip(1).take(frame.height) {
        line.values.clear();
        line.values.extend(row);
        line.transform();
        distance.extend(line.result[1..=frame.width].iter().map(|value| value.sqrt()));
    }
    distance
}

/// One line of the transform: the lower envelope of parabolas.
struct Line {
    values: Vec<f32>,
    result: Vec<f32>,
    parabolas: Vec<usize>,
    starts: Vec<f32>,
}

impl Line {
    fn new(longest: usize) -> Self {
        Self {
            values: Vec::with_capacity(longest),
            result: vec![0.0; longest],
            parabolas: Vec::with_capacity(longest),
            starts: Vec::with_capacity(longest),
        }
    }

    fn transform(&mut self) {
        let f = |at: usize| self.values[at] + (at * at) as f32;
        self.parabolas.clear();
        self.starts.clear();
        for at in 0..self.values.len() {
            let mut start = f32::NEG_INFINITY;
            while let Some(last) = self.parabolas.last().copied() {
                start = (f(at) - f(last)) / (2 * (at - last)) as f32;
                if self.starts.last().is_none_or(|from| start > *from) {
                    break;
                }
                self.parabolas.pop();
                self.starts.pop();
                start = f32::NEG_INFINITY;
            }
            self.parabolas.push(at);
            self.starts.push(start);
        }
        let mut segment = 0;
        for at in 0..self.values.len() {
            while self.starts.get(segment + 1).is_some_and(|start| *start < at as f32) {
                segment += 1;
            }
            let center = self.parabolas[segment];
            let offset = at as f32 - center as f32;
            self.result[at] = offset * offset + self.values[center];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_brute_force(open in proptest::collection::vec(proptest::bool::weighted(0.9), 12 * 9)) {
            let frame = Frame { origin_m: [0.0; 2], cell_m: 1.0, width: 12, height: 9 };
            let fast = to_closed(&open, &frame);
            for row in 0..9_i32 {
                for column in 0..12_i32 {
                    let mut nearest = i32::MAX;
                    for r in -1..=9_i32 {
                        for c in -1..=12_i32 {
                            let outside = !(0..9).contains(&r) || !(0..12).contains(&c);
                            if outside || !open[(r * 12 + c) as usize] {
                                nearest = nearest.min((r - row).pow(2) + (c - column).pow(2));
                            }
                        }
                    }
                    let value = fast[(row * 12 + column) as usize];
                    prop_assert!((value - (nearest as f32).sqrt()).abs() < 1e-4);
                }
            }
        }
    }
}
