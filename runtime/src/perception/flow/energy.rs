//! The row kernels of the variational refinement.

use multiversion::multiversion;

use super::plane::Plane;

/// Weights of smoothness, brightness and gradient: OpenCV's `DISOpticalFlow` has 20, 5 and 10.
const SMOOTHNESS: f32 = 25.0;
const BRIGHTNESS: f32 = 5.0;
const GRADIENT: f32 = 10.0;
/// The robust penalties are quadratic below this, pixels and grey levels.
const EPSILON: f32 = 0.003;
/// Gradients below this are noise, and the normalisation does not amplify their terms; grey levels per pixel.
const ZETA: f32 = 0.5;
/// Full sweeps of relaxation for each iteration, and their over-relaxation factor.
pub const SWEEPS: usize = 5;
const OMEGA: f32 = 1.6;
/// A half sweep relaxes every other pixel.
pub const HALF_SWEEPS: usize = 2 * SWEEPS;

/// Warps one row of the second image back by the flow. Fills the mean of both images, the change from the first to the second,
/// and 1 where the flow stays in the second image (else 0).
#[multiversion(targets("x86_64+avx2"))]
pub fn warp(
    from: &[f32],
    to: &Plane,
    y: usize,
    u: &[f32],
    v: &[f32],
    mean: &mut [f32],
    change: &mut [f32],
    inside: &mut [f32],
) {
    let right = (to.width - 1) as f32;
    let bottom = (to.height - 1) as f32;
    for x in 0..from.len() {
        let px = x as f32 + u[x];
        let py = y as f32 + v[x];
        let warped = to.sample(px, py);
        mean[x] = 0.5 * (from[x] + warped);
        change[x] = warped - from[x];
        inside[x] = f32::from(u8::from(px >= 0.0 && px <= right && py >= 0.0 && py <= bottom));
    }
}

/// `out = (plus - minus) * scale`.
#[multiversion(targets("x86_64+avx2"))]
pub fn difference(plus: &[f32], minus: &[f32], scale: f32, out: &mut [f32]) {
    for ((out, plus), minus) in out.iter_mut().zip(plus).zip(minus) {
        *out = (plus - minus) * scale;
    }
}

/// Second derivative along one direction, from pixels two apart.
#[multiversion(targets("x86_64+avx2"))]
pub fn second(before: &[f32], here: &[f32], after: &[f32], out: &mut [f32]) {
    for (((out, before), here), after) in out.iter_mut().zip(before).zip(here).zip(after) {
        *out = 0.25 * ((after - here) - (here - before));
    }
}

/// Second derivative along both directions: `corners` are upper left, upper right, lower left, lower right.
#[multiversion(targets("x86_64+avx2"))]
pub fn mixed(corners: [&[f32]; 4], out: &mut [f32]) {
    let [a, b, c, d] = corners.map(|corner| &corner[..out.len()]);
    for x in 0..out.len() {
        out[x] = 0.25 * ((d[x] - c[x]) - (b[x] - a[x]));
    }
}

/// A term `x (u - u0) + y (v - v0) + t`, divided by the length of its gradient, as `x u + y v + t`; zero where the flow leaves
/// the image.
#[multiversion(targets("x86_64+avx2"))]
pub fn normalise(
    x: &mut [f32],
    y: &mut [f32],
    t: &mut [f32],
    inside: &[f32],
    u0: &[f32],
    v0: &[f32],
) {
    let n = x.len();
    let y = &mut y[..n];
    let t = &mut t[..n];
    let inside = &inside[..n];
    let u0 = &u0[..n];
    let v0 = &v0[..n];
    for i in 0..n {
        let scale = inside[i] / (x[i] * x[i] + y[i] * y[i] + ZETA * ZETA).sqrt();
        x[i] *= scale;
        y[i] *= scale;
        t[i] = t[i] * scale - x[i] * u0[i] - y[i] * v0[i];
    }
}

/// Smoothness weights between a pixel and its neighbours to the right and below; `u` and `v` each hold the flow of
/// these three pixels.
#[multiversion(targets("x86_64+avx2"))]
pub fn bind(u: [&[f32]; 3], v: [&[f32]; 3], out: &mut [f32]) {
    let n = out.len();
    let [u, u_right, u_below] = u.map(|u| &u[..n]);
    let [v, v_right, v_below] = v.map(|v| &v[..n]);
    for i in 0..n {
        let ux = u_right[i] - u[i];
        let uy = u_below[i] - u[i];
        let vx = v_right[i] - v[i];
        let vy = v_below[i] - v[i];
        out[i] = SMOOTHNESS / (ux * ux + uy * uy + vx * vx + vy * vy + EPSILON * EPSILON).sqrt();
    }
}

/// The data terms' part of the linear system at the flow (`u`, `v`): fills the diagonal, the coefficient of the other
/// component and the right-hand sides.
#[multiversion(targets("x86_64+avx2"))]
pub fn assemble(
    flow: [&[f32]; 2],
    terms: [&[f32]; 9],
    a_u: &mut [f32],
    a_v: &mut [f32],
    cross: &mut [f32],
    b_u: &mut [f32],
    b_v: &mut [f32],
) {
    let n = a_u.len();
    let a_v = &mut a_v[..n];
    let cross = &mut cross[..n];
    let b_u = &mut b_u[..n];
    let b_v = &mut b_v[..n];
    let [u, v] = flow.map(|flow| &flow[..n]);
    let [x0, y0, t0, x1, y1, t1, x2, y2, t2] = terms.map(|term| &term[..n]);
    for i in 0..n {
        let r0 = x0[i] * u[i] + y0[i] * v[i] + t0[i];
        let r1 = x1[i] * u[i] + y1[i] * v[i] + t1[i];
        let r2 = x2[i] * u[i] + y2[i] * v[i] + t2[i];
        let p = BRIGHTNESS / (r0 * r0 + EPSILON * EPSILON).sqrt();
        let q = GRADIENT / (r1 * r1 + r2 * r2 + EPSILON * EPSILON).sqrt();
        a_u[i] = p * (x0[i] * x0[i]) + q * (x1[i] * x1[i] + x2[i] * x2[i]);
        a_v[i] = p * (y0[i] * y0[i]) + q * (y1[i] * y1[i] + y2[i] * y2[i]);
        cross[i] = p * (x0[i] * y0[i]) + q * (x1[i] * y1[i] + x2[i] * y2[i]);
        b_u[i] = -p * (x0[i] * t0[i]) - q * (x1[i] * t1[i] + x2[i] * t2[i]);
        b_v[i] = -p * (y0[i] * t0[i]) - q * (y1[i] * t1[i] + y2[i] * t2[i]);
    }
}

/// Converts the data terms' diagonal to the inverse of the whole diagonal.
#[multiversion(targets("x86_64+avx2"))]
pub fn invert(links: [&[f32]; 4], diagonal: &mut [f32]) {
    let n = diagonal.len();
    let [a, b, c, d] = links.map(|link| &link[..n]);
    for i in 0..n {
        // A pixel outside the image has neither data nor links.
        diagonal[i] = 1.0 / (diagonal[i] + ((a[i] + b[i]) + (c[i] + d[i])) + 1e-9);
    }
}

/// Half a row of over-relaxation for one component of the flow. `links` are to the left, right, upper and lower neighbour,
/// `weights` the inverse diagonal, the right-hand side and the coefficient of the `other` component.
#[multiversion(targets("x86_64+avx2"))]
pub fn relax(
    own: &mut [f32],
    neighbours: [&[f32]; 4],
    links: [&[f32]; 4],
    weights: [&[f32]; 3],
    other: &[f32],
) {
    let n = own.len();
    let [left, right, up, down] = neighbours.map(|neighbour| &neighbour[..n]);
    let [to_left, to_right, to_up, to_down] = links.map(|link| &link[..n]);
    let [inverse, b, cross] = weights.map(|weight| &weight[..n]);
    let other = &other[..n];
    for i in 0..n {
        let sides = to_left[i] * left[i] + to_right[i] * right[i];
        let ends = to_up[i] * up[i] + to_down[i] * down[i];
        let best = ((sides + ends) + (b[i] - cross[i] * other[i])) * inverse[i];
        own[i] += OMEGA * (best - own[i]);
    }
}
