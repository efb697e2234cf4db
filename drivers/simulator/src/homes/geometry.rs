//! Rectangles on the floor and the frames of their four walls.

/// An axis-aligned rectangle on the floor, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rect {
    /// Smallest x and y.
    pub min: [f32; 2],
    /// Largest x and y.
    pub max: [f32; 2],
}

impl Rect {
    /// Creates a rectangle from its corners with the smallest and the largest coordinates.
    pub const fn new(x0: f32, y0: f32, x1: f32, y1: f32) -> Self {
        Self { min: [x0, y0], max: [x1, y1] }
    }

    /// Extent along x and y, metres.
    pub fn size(&self) -> [f32; 2] {
        [self.max[0] - self.min[0], self.max[1] - self.min[1]]
    }

    pub fn area_m2(&self) -> f32 {
        self.size()[0] * self.size()[1]
    }

    pub fn center(&self) -> [f32; 2] {
        [(self.min[0] + self.max[0]) / 2.0, (self.min[1] + self.max[1]) / 2.0]
    }

    /// The rectangle enlarged by `margin_m` on every side; a negative margin shrinks it.
    pub fn grown(&self, margin_m: f32) -> Self {
        Self::new(
            self.min[0] - margin_m,
            self.min[1] - margin_m,
            self.max[0] + margin_m,
            self.max[1] + margin_m,
        )
    }

    /// Whether a point lies inside or on the border.
    pub fn contains(&self, p: [f32; 2]) -> bool {
        (0..2).all(|i| p[i] >= self.min[i] && p[i] <= self.max[i])
    }

    /// Whether `inner` lies inside.
    pub fn covers(&self, inner: &Self) -> bool {
        self.contains(inner.min) && self.contains(inner.max)
    }

    pub fn overlaps(&self, other: &Self) -> bool {
        (0..2).all(|i| self.min[i] < other.max[i] && other.min[i] < self.max[i])
    }

    /// Distance of a point to the rectangle, 0 inside.
    pub fn distance_m(&self, p: [f32; 2]) -> f32 {
        let [x, y] = [0, 1].map(|i| (self.min[i] - p[i]).max(p[i] - self.max[i]).max(0.0));
        x.hypot(y)
    }

    /// The frame of one wall.
    pub fn wall(&self, side: Side) -> WallFrame {
        let [w, d] = self.size();
        match side {
            Side::South => {
                WallFrame { origin: self.min, along: [1.0, 0.0], inward: [0.0, 1.0], length_m: w }
            }
            Side::East => WallFrame {
                origin: [self.max[0], self.min[1]],
                along: [0.0, 1.0],
                inward: [-1.0, 0.0],
                length_m: d,
            },
            Side::North => {
                WallFrame { origin: self.max, along: [-1.0, 0.0], inward: [0.0, -1.0], length_m: w }
            }
            Side::West => WallFrame {
                origin: [self.min[0], self.max[1]],
                along: [0.0, -1.0],
                inward: [1.0, 0.0],
                length_m: d,
            },
        }
    }
}

/// One of a room's four walls, counter-clockwise seen from above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The wall at the smallest y.
    South,
    /// The wall at the largest x.
    East,
    /// The wall at the largest y.
    North,
    /// The wall at the smallest x.
    West,
}

impl Side {
    /// All four sides, in the order of their quarter rotations.
    pub const ALL: [Self; 4] = [Self::South, Self::East, Self::North, Self::West];

    /// Number of quarter rotations from the south wall's frame to this wall's.
    pub fn quarter_rotations(self) -> usize {
        self as usize
    }
}

/// A wall seen from its room: `along` the wall, `inward` from it, and up are a right-handed frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WallFrame {
    /// Corner of the room where `along` starts.
    pub origin: [f32; 2],
    /// Unit vector along the wall.
    pub along: [f32; 2],
    /// Unit vector into the room.
    pub inward: [f32; 2],
    pub length_m: f32,
}

impl WallFrame {
    /// The point `s` along the wall and `depth` inwards.
    pub fn at(&self, s: f32, depth: f32) -> [f32; 2] {
        [
            self.origin[0] + self.along[0] * s + self.inward[0] * depth,
            self.origin[1] + self.along[1] * s + self.inward[1] * depth,
        ]
    }

    pub fn at3(&self, s: f32, depth: f32, z: f32) -> [f32; 3] {
        let [x, y] = self.at(s, depth);
        [x, y, z]
    }

    /// Position of a point along the wall, metres.
    pub fn project(&self, p: [f32; 2]) -> f32 {
        (p[0] - self.origin[0]) * self.along[0] + (p[1] - self.origin[1]) * self.along[1]
    }

    /// The rectangle between two stations and two depths.
    pub fn rect(&self, s: [f32; 2], depth: [f32; 2]) -> Rect {
        let a = self.at(s[0], depth[0]);
        let b = self.at(s[1], depth[1]);
        Rect::new(a[0].min(b[0]), a[1].min(b[1]), a[0].max(b[0]), a[1].max(b[1]))
    }
}
