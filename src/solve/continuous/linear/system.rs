// SPDX-License-Identifier: MIT OR Apache-2.0

//! The normal equations of a window: a banded matrix of the path's coefficients, bordered by γ and κ.
//!
//! N·δc + b·δ = g, N the matrix of the path, b the border and δ the step of γ and κ. The path is eliminated
//! by the Schur complement S′ = S − bᵀN⁻¹b; then γ and κ are solved, and the path is substituted back.

use super::banded::Banded;
use super::evaluated::EvaluatedPair;
use super::shared::{SHARED, Shared};
use crate::cpu::CpuLevel;
use nalgebra::{SMatrix, SVector};

/// Normal equations of γ and κ.
#[derive(Clone, Copy, Debug)]
pub struct SharedEquations {
    pub information: SMatrix<f64, SHARED, SHARED>,
    pub right: SVector<f64, SHARED>,
}

/// The normal equations of a window; memory is reused.
#[derive(Clone, Debug, Default)]
pub struct System {
    /// N; its Cholesky factor after [`System::solve_path`].
    pub matrix: Banded,
    /// g; the step of the path after [`System::solve_path`].
    pub right: Vec<f64>,
    /// b and N⁻¹·b.
    border: Shared<Vec<f64>>,
    weighted: Shared<Vec<f64>>,
}

impl System {
    /// Sums the equations of pairs, in a band with these first columns; returns those of γ and κ.
    pub fn assemble<'a>(
        &mut self,
        first: Vec<usize>,
        pairs: impl Iterator<Item = &'a EvaluatedPair>,
    ) -> SharedEquations {
        let size = first.len();
        self.matrix.reset(first);
        for values in self.border.as_mut().into_array().into_iter().chain([&mut self.right]) {
            values.clear();
            values.resize(size, 0.0);
        }
        let mut shared = SharedEquations { information: SMatrix::zeros(), right: SVector::zeros() };
        for pair in pairs {
            let right = pair.right();
            pair.normal.equations.add_to(right, &mut self.matrix, &mut self.right, &mut self.border);
            shared.information += pair.normal.shared;
            shared.right += pair.shared_right();
        }
        shared
    }

    /// Factorises N and solves the path for fixed γ and κ; false if N is not positive definite.
    pub fn solve_path(&mut self, cpu: CpuLevel) -> bool {
        let is_definite = self.matrix.factorise(cpu);
        if is_definite {
            self.matrix.solve(cpu, &mut self.right);
        }
        is_definite
    }

    /// The equations of γ and κ with the path eliminated; after [`System::solve_path`].
    pub fn eliminate_path(&mut self, cpu: CpuLevel, mut shared: SharedEquations) -> SharedEquations {
        for (weighted, border) in self.weighted.as_mut().zip(self.border.as_ref()).into_array() {
            weighted.clone_from(border);
            self.matrix.solve(cpu, weighted);
        }
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let weighted = self.weighted.as_ref().into_array();
        for (p, border) in self.border.as_ref().into_array().into_iter().enumerate() {
            shared.right[p] -= dot(border, &self.right);
            for (q, weighted) in weighted.into_iter().enumerate() {
                shared.information[(p, q)] -= dot(border, weighted);
            }
        }
        shared
    }

    /// Substitutes the step of γ and κ into that of the path; whether the latter is finite.
    pub fn substitute(&mut self, changes: Shared<f64>) -> bool {
        for (by, change) in self.weighted.as_ref().zip(changes).into_array() {
            self.right.iter_mut().zip(by).for_each(|(step, by)| *step -= by * change);
        }
        self.right.iter().all(|step| step.is_finite())
    }
}
