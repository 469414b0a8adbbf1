//! In plain Rust: the reference.

use super::{AREA, Block, Centred, SIDE, Sums, free_of_contrast};

type Lanes = [f32; SIDE];

pub(super) fn centred(rows: &[f32], stride: usize) -> Option<Centred> {
    let row = |r: usize| -> Option<&[f32; SIDE + 2]> { rows.get(r * stride..)?.first_chunk() };
    let zero = [[0.0; SIDE]; SIDE];
    let (mut values, mut gradient_x, mut gradient_y) = (zero, zero, zero);
    let mut sums = [[0.0; SIDE]; 3];
    for r in 0..SIDE {
        let (above, here, below) = (row(r)?, row(r + 1)?, row(r + 2)?);
        for c in 0..SIDE {
            values[r][c] = here[c + 1];
            gradient_x[r][c] = 0.5 * (here[c + 2] - here[c]);
            gradient_y[r][c] = 0.5 * (below[c + 1] - above[c + 1]);
            sums[0][c] += values[r][c];
            sums[1][c] += gradient_x[r][c];
            sums[2][c] += gradient_y[r][c];
        }
    }
    let means = sums.map(|lanes| total(lanes) * (1.0 / AREA));
    let mut products = [[0.0; SIDE]; 6];
    for r in 0..SIDE {
        for c in 0..SIDE {
            let value = values[r][c] - means[0];
            let (dx, dy) = (gradient_x[r][c] - means[1], gradient_y[r][c] - means[2]);
            (values[r][c], gradient_x[r][c], gradient_y[r][c]) = (value, dx, dy);
            products[0][c] += dx * dx;
            products[1][c] += dx * dy;
            products[2][c] += dy * dy;
            products[3][c] += value * value;
            products[4][c] += dx * value;
            products[5][c] += dy * value;
        }
    }
    let (products, [x, y]) = free_of_contrast(products.map(total));
    for r in 0..SIDE {
        for c in 0..SIDE {
            gradient_x[r][c] -= x * values[r][c];
            gradient_y[r][c] -= y * values[r][c];
        }
    }
    Some(Centred { values, gradient_x, gradient_y, products })
}

pub(super) fn sums(patch: &Centred, rows: &[f32], stride: usize, across: f32, down: f32) -> Option<Sums> {
    let (mut slope, mut differences, mut squares) = ([[0.0; SIDE]; 2], [[0.0; SIDE]; 2], [[0.0; SIDE]; 2]);
    let mut above = blended(rows, across)?;
    for r in 0..SIDE {
        let below = blended(rows.get((r + 1) * stride..)?, across)?;
        let half = r / (SIDE / 2);
        for c in 0..SIDE {
            let sample = above[c] + down * (below[c] - above[c]);
            let difference = sample - patch.values[r][c];
            slope[0][c] += patch.gradient_x[r][c] * difference;
            slope[1][c] += patch.gradient_y[r][c] * difference;
            differences[half][c] += difference;
            squares[half][c] += difference * difference;
        }
        above = below;
    }
    let quarters = |[top, bottom]: [Lanes; 2]| {
        let ([a, b], [c, d]) = (halves(top), halves(bottom));
        [a, c, b, d]
    };
    let [differences, squares] = [quarters(differences), quarters(squares)];
    let four = |values: [f32; 4]| (values[0] + values[1]) + (values[2] + values[3]);
    let mean = four(differences) * (1.0 / AREA);
    let squares =
        std::array::from_fn(|k| (squares[k] - mean * (2.0 * differences[k] - 0.25 * AREA * mean)).max(0.0));
    Some(Sums { slope: slope.map(total), squares, total: four(squares) })
}

pub(super) fn whole_sums(values: &Block, rows: &[f32], stride: usize) -> Option<[f32; 2]> {
    let mut sums = [[0.0; SIDE]; 2];
    for (r, values) in values.iter().enumerate() {
        let row: &Lanes = rows.get(r * stride..)?.first_chunk()?;
        for c in 0..SIDE {
            let difference = row[c] - values[c];
            sums[0][c] += difference;
            sums[1][c] += difference * difference;
        }
    }
    Some(sums.map(total))
}

/// A row of samples between pixels.
fn blended(row: &[f32], across: f32) -> Option<Lanes> {
    let row: &[f32; SIDE + 1] = row.first_chunk()?;
    Some(std::array::from_fn(|c| row[c] + across * (row[c + 1] - row[c])))
}

/// Sums of the left and of the right half.
fn halves(lanes: Lanes) -> [f32; 2] {
    [(lanes[0] + lanes[1]) + (lanes[2] + lanes[3]), (lanes[4] + lanes[5]) + (lanes[6] + lanes[7])]
}

fn total(lanes: Lanes) -> f32 {
    let [left, right] = halves(lanes);
    left + right
}
