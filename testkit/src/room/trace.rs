//! Quads, and a tree of boxes over them that finds the nearest one along a ray.

use nalgebra::Vector3;

/// Flat rectangle: `origin + s * u + t * v` with s, t in 0..1.
#[derive(Debug, Clone)]
pub(super) struct Quad {
    pub(super) origin: Vector3<f64>,
    pub(super) u: Vector3<f64>,
    pub(super) v: Vector3<f64>,
    /// Unit, u x v: the side that is lit and seen.
    pub(super) normal: Vector3<f64>,
    pub(super) texture: usize,
    /// Varies textures that are used more than once.
    pub(super) seed: u64,
}

impl Quad {
    pub(super) fn new(
        origin: Vector3<f64>,
        u: Vector3<f64>,
        v: Vector3<f64>,
        texture: usize,
        seed: u64,
    ) -> Self {
        Self {
            origin,
            u,
            v,
            normal: u.cross(&v).normalize(),
            texture,
            seed,
        }
    }

    /// Lengths of u and v in metres.
    pub(super) fn size(&self) -> (f64, f64) {
        (self.u.norm(), self.v.norm())
    }

    fn hit(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<Hit> {
        let along = self.normal.dot(direction);
        if along > -1e-12 {
            return None; // from behind or parallel: solids are closed, so the other side is never seen
        }
        let distance = self.normal.dot(&(self.origin - origin)) / along;
        if distance < 1e-7 {
            return None;
        }
        let local = origin + distance * direction - self.origin;
        let s = local.dot(&self.u) / self.u.norm_squared();
        let t = local.dot(&self.v) / self.v.norm_squared();
        ((0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t)).then_some(Hit {
            quad: 0,
            distance,
            s,
            t,
        })
    }
}

/// Where a ray meets a quad.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    pub(super) quad: usize,
    pub(super) distance: f64,
    pub(super) s: f64,
    pub(super) t: f64,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    low: Vector3<f64>,
    high: Vector3<f64>,
    /// First quad of a leaf, or the right child (the left one follows its parent).
    link: usize,
    /// Number of quads; 0 for an inner node.
    count: usize,
}

/// Tree of axis-aligned boxes.
#[derive(Debug)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    order: Vec<usize>,
}

impl Bvh {
    pub(super) fn new(quads: &[Quad]) -> Self {
        let mut tree = Self {
            nodes: Vec::new(),
            order: (0..quads.len()).collect(),
        };
        tree.grow(quads, 0, quads.len());
        tree
    }

    fn grow(&mut self, quads: &[Quad], first: usize, end: usize) {
        let (mut low, mut high) = (
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        );
        for &i in &self.order[first..end] {
            let q = &quads[i];
            for corner in [
                q.origin,
                q.origin + q.u,
                q.origin + q.v,
                q.origin + q.u + q.v,
            ] {
                low = low.inf(&corner);
                high = high.sup(&corner);
            }
        }
        let slack = Vector3::repeat(1e-9);
        let here = self.nodes.len();
        self.nodes.push(Node {
            low: low - slack,
            high: high + slack,
            link: first,
            count: end - first,
        });
        if end - first <= 4 {
            return;
        }
        let axis = (high - low).imax();
        let middle = |i: usize| {
            let q = &quads[i];
            q.origin[axis] + 0.5 * (q.u[axis] + q.v[axis])
        };
        self.order[first..end].sort_by(|&a, &b| middle(a).total_cmp(&middle(b)).then(a.cmp(&b)));
        let split = first + (end - first) / 2;
        self.grow(quads, first, split);
        let right = self.nodes.len();
        self.grow(quads, split, end);
        self.nodes[here].link = right;
        self.nodes[here].count = 0;
    }

    /// The nearest quad whose front the ray meets before `limit`. The direction has unit length.
    pub(super) fn nearest(
        &self,
        quads: &[Quad],
        origin: &Vector3<f64>,
        direction: &Vector3<f64>,
        limit: f64,
    ) -> Option<Hit> {
        let inverse = direction.map(|d| 1.0 / d);
        let mut best: Option<Hit> = None;
        let mut limit = limit;
        let mut stack = [0usize; 64];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let index = stack[top];
            let node = &self.nodes[index];
            let (mut near, mut far) = (0.0f64, limit);
            for axis in 0..3 {
                let a = (node.low[axis] - origin[axis]) * inverse[axis];
                let b = (node.high[axis] - origin[axis]) * inverse[axis];
                near = near.max(a.min(b));
                far = far.min(a.max(b));
            }
            if near > far {
                continue;
            }
            if node.count == 0 {
                stack[top] = node.link;
                stack[top + 1] = index + 1;
                top += 2;
                continue;
            }
            for &i in &self.order[node.link..node.link + node.count] {
                if let Some(hit) = quads[i].hit(origin, direction)
                    && hit.distance < limit
                {
                    limit = hit.distance;
                    best = Some(Hit { quad: i, ..hit });
                }
            }
        }
        best
    }
}
