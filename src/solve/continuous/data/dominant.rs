//! The motion that most matches of a pair share.
//!
//! A path stands for one motion. Where something that moves on its own fills a good part of the picture, a fit to
//! everything finds neither motion, for each bends the path for the other. Which matches move together is found before
//! there is any path, by the least median of squares (P. J. Rousseeuw, *Least median of squares regression*, JASA
//! 79(388), 1984): of many affine motions through three matches, the one from which half of them are off
//! least. It is made quadratic in the point, near enough to what perspective, a turn and the shutter do from
//! one frame to the next.
//!
//! The scene goes round what moves in it: a match counts by its squared distance from the image centre. And
//! what did not belong to the scene in the pair before has no vote in this one.

use super::matches::Match;
use crate::robust::loss::GemanMcClure;
use crate::robust::median::median;
use crate::robust::motion::{Motion, Round, Sample, Scale, fit, quadratic};
use nalgebra::{Matrix2x3, Matrix3, SMatrix};

/// Matches that vote, drawn by what they count.
const VOTERS: f64 = 128.0;
/// What a match in the centre counts, in squared radii.
const CENTRE: f64 = 0.2;
/// Affine motions that are tried: were half of the matches of one motion, 1 of 8 would be through three of them.
const TRIALS: usize = 64;
/// Those of them that are made quadratic, and in how many rounds.
const FINALISTS: usize = 6;
const ROUNDS: usize = 4;
/// The loss of these rounds: a match two deviations off counts a quarter.
const LOSS: GemanMcClure = GemanMcClure(4.0);
/// Matches of one motion are off it by this share of the usual displacement at least: it is not quite quadratic.
const UNEVEN: f64 = 0.02;
/// Matches that are off by more than so many deviations are outliers.
const REACH: f64 = 5.0;
/// Where fewer than this share of the matches may vote, all may.
const QUORUM: f64 = 0.25;
/// Terms of a quadratic.
const TERMS: usize = 6;
/// Keeps a quadratic through points on a line finite.
const RIDGE: f64 = 1e-3;
/// Steps of a sequence that fills the unit cube evenly: powers of the root of x⁴ = x + 1 (M. Roberts, 2018).
const EVEN: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_2];

type Quadratic = Motion<f64, TERMS>;
type Voter = Sample<f64, TERMS>;

/// The displacement that most of the matches share, as a function of where they set out.
#[derive(Clone, Debug)]
pub struct Dominant {
    motion: Quadratic,
    /// The greatest squared distance from it of a match that shares it.
    reach: f64,
}

fn sample(m: &Match) -> Voter {
    Sample { terms: quadratic(m.from), displacement: m.to - m.from, weight: 1.0 }
}

impl Dominant {
    /// The motion of matches; those of which `votes` is false did not share that of the pair before.
    pub fn of(matches: &[Match], votes: &[bool]) -> Self {
        let entitled: Vec<&Match> =
            matches.iter().zip(votes).filter(|(_, votes)| **votes).map(|(m, _)| m).collect();
        let is_quorate = entitled.len() as f64 >= QUORUM * matches.len() as f64;
        let voters = if is_quorate { draw(&entitled) } else { draw(&matches.iter().collect::<Vec<_>>()) };
        let mut squares: Vec<f64> = voters.iter().map(|voter| voter.displacement.norm_squared()).collect();
        let least = UNEVEN * UNEVEN * median(&mut squares);
        let mut variance = |motion: &Quadratic| motion.variance(voters.iter().copied(), least, &mut squares);
        let mut tried: Vec<(f64, Quadratic)> =
            (0..TRIALS).filter_map(|trial| affine(&voters, trial)).map(|m| (variance(&m), m)).collect();
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut best = (f64::INFINITY, Motion(SMatrix::zeros()));
        for (mut variance_of, mut motion) in tried.into_iter().take(FINALISTS) {
            for _ in 0..ROUNDS {
                let Some(finer) = refined(&voters, motion, variance_of) else { break };
                let left = variance(&finer);
                if left >= variance_of {
                    break;
                }
                (variance_of, motion) = (left, finer);
            }
            if variance_of < best.0 {
                best = (variance_of, motion);
            }
        }
        let (variance, motion) = best;
        Self { motion, reach: 2.0 * REACH * REACH * variance }
    }

    /// Whether a match shares it.
    pub fn holds(&self, m: &Match) -> bool {
        self.motion.square(&sample(m)) <= self.reach
    }
}

/// Draws voters evenly by what they count.
fn draw(matches: &[&Match]) -> Vec<Voter> {
    let count = |m: &Match| CENTRE + m.from.norm_squared();
    let total: f64 = matches.iter().map(|m| count(m)).sum();
    let mut sum = 0.5;
    let mut voters = Vec::new();
    for m in matches {
        let before = f64::floor(sum);
        sum += VOTERS * count(m) / total;
        voters.extend(std::iter::repeat_n(sample(m), (sum.floor() - before) as usize));
    }
    voters
}

/// An affine motion through three voters.
fn affine(voters: &[Voter], trial: usize) -> Option<Quadratic> {
    let at = |step: f64| voters.get(((0.5 + step * trial as f64).fract() * voters.len() as f64) as usize);
    let [a, b, c] = EVEN.map(at);
    let three = [*a?, *b?, *c?];
    let points = Matrix3::from_columns(&three.map(|voter| voter.terms.fixed_resize(0.0)));
    let affine = Matrix2x3::from_columns(&three.map(|voter| voter.displacement)) * points.try_inverse()?;
    Some(Motion(affine.fixed_resize(0.0)))
}

/// One round of the robust fit from another motion, whose residuals have this variance.
fn refined(voters: &[Voter], motion: Quadratic, variance: f64) -> Option<Quadratic> {
    let round = Round { scale: Scale::Variance(variance), ridge: [RIDGE; TERMS] };
    fit(voters.iter().copied(), motion, LOSS, [round])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::random::Random;
    use nalgebra::{Matrix2, Vector2};

    /// Matches over the picture that turn and speed up with the row; those within `side` of the centre along both axes
    /// move by `own` more.
    fn scene(side: f64, own: Vector2<f64>) -> Vec<Match> {
        let mut random = Random(7);
        let mut point = || {
            let [x, y] = [1.0, 0.75].map(|size| size * (2.0 * random.uniform() - 1.0));
            let from = Vector2::new(x, y);
            let scene = Vector2::new(0.1 - 0.02 * y + 0.01 * y * y, 0.03 + 0.02 * x);
            let error = Vector2::new(random.normal(), random.normal()) * 3e-4;
            let is_inside = x.abs() < side && y.abs() < side;
            Match {
                from,
                to: from + scene + error + if is_inside { own } else { Vector2::zeros() },
                covariance: Matrix2::zeros(),
            }
        };
        (0..300).map(|_| point()).collect()
    }

    fn told(matches: &[Match], votes: &[bool]) -> impl Iterator<Item = bool> {
        let dominant = Dominant::of(matches, votes);
        matches.iter().map(move |m| dominant.holds(m))
    }

    fn is_inside(m: &Match, side: f64) -> bool {
        m.from.x.abs() < side && m.from.y.abs() < side
    }

    #[test]
    fn what_moves_on_its_own_is_told_from_the_scene() {
        // A square of 1.2 × 1.2 of a picture of 2 × 1.5: nearly half of it.
        let matches = scene(0.6, Vector2::new(0.04, -0.02));
        let inside = matches.iter().map(|m| is_inside(m, 0.6));
        let wrong =
            told(&matches, &[true; 300]).zip(inside).filter(|(holds, inside)| holds == inside).count();
        assert!(wrong <= 3, "{wrong}");
    }

    #[test]
    fn what_went_its_own_way_before_has_no_vote() {
        // 1.46 × 1.5 of 2 × 1.5: most of the picture, by what matches count, too.
        let matches = scene(0.73, Vector2::new(0.04, -0.02));
        let inside = matches.iter().map(|m| is_inside(m, 0.73));
        for (of_inside, votes) in
            [(true, vec![true; 300]), (false, inside.clone().map(|inside| !inside).collect())]
        {
            let wrong = told(&matches, &votes)
                .zip(inside.clone())
                .filter(|(holds, inside)| *holds != (*inside == of_inside));
            assert!(wrong.count() <= 6, "{of_inside}");
        }
    }

    #[test]
    fn one_motion_is_one_motion() {
        let matches = scene(0.0, Vector2::zeros());
        assert!(told(&matches, &[true; 300]).all(|holds| holds));
        let still: Vec<Match> = matches.iter().map(|m| Match { to: m.from, ..*m }).collect();
        assert!(told(&still, &[true; 300]).all(|holds| holds));
        // On a line a quadratic is not determined.
        let line: Vec<Match> =
            matches.iter().map(|m| Match { from: m.from.component_mul(&Vector2::x()), ..*m }).collect();
        assert_eq!(told(&line, &[true; 300]).count(), 300);
    }
}
