//! Sparse symmetric systems: the pattern is built once, values are refilled, and the factorisation says how many of
//! its pivots are negative.
//!
//! A system is a sum of small dense blocks (one for each finite element), so the pattern is given by the unknowns
//! of each block, and a block is added through a map that was worked out beforehand. The elimination order comes
//! from [`dissect`]: the blocks are halved geometrically again and again, and the unknowns that two halves share
//! are eliminated after both. For solids this needs 2 to 6 times less work than minimum degree.

use std::sync::Arc;

use faer::Par;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::ldlt::factor::LdltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LdltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Side};
use thiserror::Error;

/// Marks a row of a block that is no unknown (held, or eliminated elsewhere).
pub const HELD: usize = usize::MAX;

/// What a sparse system refuses.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SparseError {
    /// The system is too large for this machine's memory.
    #[error("a sparse system of {0} unknowns does not fit into memory: use a coarser mesh")]
    Memory(usize),
    /// A pivot is zero or not finite.
    #[error("the tangent of {0} unknowns is singular or not finite")]
    Singular(usize),
}

/// A symmetric matrix (lower half, compressed columns) and its LDL^T factorisation.
pub struct Symmetric {
    pattern: Arc<Pattern>,
    values: Vec<f64>,
    factor: Vec<f64>,
    memory: MemBuffer,
}

/// What all matrices that are the sum of the same blocks share.
struct Pattern {
    size: usize,
    column_starts: Vec<usize>,
    rows: Vec<usize>,
    /// For each block, the position in the values of its lower half, column by column; held entries excepted.
    maps: Vec<Vec<u32>>,
    blocks: Vec<Vec<usize>>,
    symbolic: SymbolicCholesky<usize>,
}

impl std::fmt::Debug for Symmetric {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (size, entries) = (self.size(), self.values.len());
        write!(f, "Symmetric({size} unknowns, {entries} entries, {} in the factor)", self.factor.len())
    }
}

impl Symmetric {
    /// The system of `size` unknowns that is the sum of dense blocks on the unknowns `blocks` ([`HELD`] rows are
    /// skipped), to be eliminated in the order `order` (a permutation of `0..size`, first eliminated first).
    pub fn new(size: usize, blocks: Vec<Vec<usize>>, order: &[usize]) -> Result<Symmetric, SparseError> {
        let mut touching: Vec<Vec<u32>> = vec![Vec::new(); size];
        for (b, block) in blocks.iter().enumerate() {
            for &i in block.iter().filter(|&&i| i != HELD) {
                touching[i].push(b as u32);
            }
        }
        let mut column_starts = vec![0];
        let mut rows: Vec<usize> = Vec::new();
        let mut seen = vec![HELD; size];
        for (column, of) in touching.iter().enumerate() {
            let start = rows.len();
            for &b in of {
                for &row in blocks[b as usize].iter().filter(|&&i| i != HELD && i >= column) {
                    if seen[row] != column {
                        seen[row] = column;
                        rows.push(row);
                    }
                }
            }
            rows[start..].sort_unstable();
            column_starts.push(rows.len());
        }
        if u32::try_from(rows.len()).is_err() {
            return Err(SparseError::Memory(size));
        }
        // One column at a time: where is each row of it.
        let mut maps: Vec<Vec<u32>> = blocks.iter().map(|b| vec![u32::MAX; b.len() * (b.len() + 1) / 2]).collect();
        let mut place = vec![0_u32; size];
        for (column, of) in touching.iter().enumerate() {
            for position in column_starts[column]..column_starts[column + 1] {
                place[rows[position]] = position as u32;
            }
            for &b in of {
                let (block, map) = (&blocks[b as usize], &mut maps[b as usize]);
                for (c, _) in block.iter().enumerate().filter(|&(_, &i)| i == column) {
                    for (r, &row) in block.iter().enumerate().filter(|&(_, &i)| i != HELD && i >= column) {
                        map[packed(r, c)] = place[row];
                    }
                }
            }
        }
        let mut inverse = vec![0; size];
        for (at, &unknown) in order.iter().enumerate() {
            inverse[unknown] = at;
        }
        let symbolic = factorize_symbolic_cholesky(
            SymbolicSparseColMatRef::new_checked(size, size, &column_starts, None, &rows),
            Side::Lower,
            SymmetricOrdering::Custom(PermRef::new_checked(order, &inverse, size)),
            CholeskySymbolicParams {
                supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
                ..Default::default()
            },
        )
        .map_err(|_| SparseError::Memory(size))?;
        Symmetric::of(Arc::new(Pattern { size, column_starts, rows, maps, blocks, symbolic }))
    }

    /// Another matrix that is the sum of the same blocks, all zero: it shares the pattern and the elimination order.
    pub fn alike(&self) -> Result<Symmetric, SparseError> {
        Symmetric::of(self.pattern.clone())
    }

    fn of(pattern: Arc<Pattern>) -> Result<Symmetric, SparseError> {
        let symbolic = &pattern.symbolic;
        let need = symbolic
            .factorize_numeric_ldlt_scratch::<f64>(Par::Seq, Default::default())
            .or(symbolic.solve_in_place_scratch::<f64>(MAX_RIGHT_SIDES, Par::Seq));
        let memory = MemBuffer::try_new(need).map_err(|_| SparseError::Memory(pattern.size))?;
        let (values, factor) = (vec![0.0; pattern.rows.len()], vec![0.0; symbolic.len_val()]);
        Ok(Symmetric { pattern, values, factor, memory })
    }

    /// Number of unknowns.
    pub fn size(&self) -> usize {
        self.pattern.size
    }

    /// Entries of the factor: what it costs.
    pub fn factor_entries(&self) -> usize {
        self.factor.len()
    }

    /// The unknowns of each block.
    pub fn blocks(&self) -> &[Vec<usize>] {
        &self.pattern.blocks
    }

    /// Sets all entries to zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds a dense symmetric matrix (column-major, both halves filled, at least as large as the block, with
    /// `stride` rows) to block `block`.
    pub fn add(&mut self, block: usize, dense: &[f64], stride: usize) {
        let (unknowns, map) = (&self.pattern.blocks[block], &self.pattern.maps[block]);
        for (c, &column) in unknowns.iter().enumerate() {
            if column == HELD {
                continue;
            }
            for (r, &row) in unknowns.iter().enumerate().take(c + 1) {
                if row != HELD {
                    // An unknown may stand in a block twice: then both halves meet on the diagonal.
                    let twice = if row == column && r != c { 2.0 } else { 1.0 };
                    self.values[map[packed(r, c)] as usize] += twice * dense[c * stride + r];
                }
            }
        }
    }

    /// The matrix times a vector.
    #[cfg(test)]
    pub(super) fn times(&self, x: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; self.pattern.size];
        for c in 0..self.pattern.size {
            for at in self.pattern.column_starts[c]..self.pattern.column_starts[c + 1] {
                let (r, value) = (self.pattern.rows[at], self.values[at]);
                product[r] += value * x[c];
                if r != c {
                    product[c] += value * x[r];
                }
            }
        }
        product
    }

    /// Factorises; returns the number of negative pivots, which is the number of negative eigenvalues.
    pub fn factorize(&mut self) -> Result<usize, SparseError> {
        let singular = SparseError::Singular(self.pattern.size);
        let pattern = SymbolicSparseColMatRef::new_checked(
            self.pattern.size,
            self.pattern.size,
            &self.pattern.column_starts,
            None,
            &self.pattern.rows,
        );
        self.pattern
            .symbolic
            .factorize_numeric_ldlt(
                &mut self.factor,
                SparseColMatRef::new(pattern, &self.values),
                Side::Lower,
                LdltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .map_err(|_| singular)?;
        let mut negative = 0;
        if let SymbolicCholeskyRaw::Supernodal(raw) = self.pattern.symbolic.raw() {
            for s in 0..raw.n_supernodes() {
                let columns = raw.supernode_end()[s] - raw.supernode_begin()[s];
                let stride = columns + raw.supernode(s).pattern().len();
                let start = raw.col_ptr_for_val()[s];
                for j in 0..columns {
                    let pivot = self.factor[start + j * (stride + 1)];
                    if !pivot.is_finite() || pivot == 0.0 {
                        return Err(singular);
                    }
                    negative += usize::from(pivot < 0.0);
                }
            }
        }
        Ok(negative)
    }

    /// Solves for the right-hand sides in `columns` (column-major, `size` rows, at most [`MAX_RIGHT_SIDES`]) with
    /// the last factorisation, in place.
    pub fn solve(&mut self, columns: &mut [f64]) {
        let count = columns.len() / self.pattern.size.max(1);
        LdltRef::new(&self.pattern.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(columns, self.pattern.size, count),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
    }
}

/// Most right-hand sides of one [`Symmetric::solve`].
pub const MAX_RIGHT_SIDES: usize = 8;

/// Position of an entry in a packed triangle, either half.
fn packed(r: usize, c: usize) -> usize {
    let (low, high) = (r.min(c), r.max(c));
    high * (high + 1) / 2 + low
}

/// Nested dissection of groups of unknowns ("nodes", numbered from 0 to `count`) that are coupled by blocks: the
/// order of elimination of the nodes. `blocks` lists each block's nodes, `centers` where it is, in units in which
/// blocks are about of size 1.
pub fn dissect(count: usize, blocks: &[Vec<usize>], centers: &[[f64; 3]]) -> Vec<usize> {
    let mut dissection = Dissection { blocks, centers, side: vec![0; count], done: vec![false; count] };
    let mut order = Vec::with_capacity(count);
    let all: Vec<usize> = (0..blocks.len()).collect();
    dissection.halve(all, &mut order);
    order.extend((0..count).filter(|&n| !dissection.done[n]));
    order
}

struct Dissection<'a> {
    blocks: &'a [Vec<usize>],
    centers: &'a [[f64; 3]],
    /// Bits: the halves that a node has been seen in.
    side: Vec<u8>,
    done: Vec<bool>,
}

impl Dissection<'_> {
    fn halve(&mut self, mut set: Vec<usize>, order: &mut Vec<usize>) {
        let extent = |axis: usize| {
            let of = || set.iter().map(|&b| self.centers[b][axis]);
            of().fold(f64::NEG_INFINITY, f64::max) - of().fold(f64::INFINITY, f64::min)
        };
        let axis = (0..3).max_by(|&a, &b| extent(a).total_cmp(&extent(b))).unwrap_or(0);
        set.sort_by(|&a, &b| self.centers[a][axis].total_cmp(&self.centers[b][axis]));
        let upper = set.split_off(set.len() / 2);
        let mut separator = Vec::new();
        if !set.is_empty() {
            for (half, bit) in [(&set, 1), (&upper, 2)] {
                for &n in half.iter().flat_map(|&b| &self.blocks[b]) {
                    if !self.done[n] {
                        self.side[n] |= bit;
                    }
                }
            }
            for &n in set.iter().flat_map(|&b| &self.blocks[b]) {
                if self.side[n] == 3 && !self.done[n] {
                    self.done[n] = true;
                    separator.push(n);
                }
            }
            for half in [&set, &upper] {
                for &n in half.iter().flat_map(|&b| &self.blocks[b]) {
                    self.side[n] = 0;
                }
            }
            self.halve(set, order);
            self.halve(upper, order);
        } else {
            for &n in upper.iter().flat_map(|&b| &self.blocks[b]) {
                if !self.done[n] {
                    self.done[n] = true;
                    separator.push(n);
                }
            }
        }
        order.append(&mut separator);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// A chain of dense blocks of 4 unknowns that share one with the next; the first unknown is held.
    fn chain(blocks: usize, shift: f64) -> (Symmetric, DMatrix<f64>) {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let size = 3 * blocks;
        let unknown = |i: usize| if i == 0 { HELD } else { i - 1 };
        let lists: Vec<Vec<usize>> = (0..blocks).map(|b| (3 * b..3 * b + 4).rev().map(unknown).collect()).collect();
        let nodes: Vec<Vec<usize>> = lists.iter().map(|l| l.iter().copied().filter(|&i| i != HELD).collect()).collect();
        let centers: Vec<[f64; 3]> = (0..blocks).map(|b| [b as f64, 0.0, 0.0]).collect();
        let order = dissect(size, &nodes, &centers);
        let mut sparse = Symmetric::new(size, lists.clone(), &order).unwrap();
        let mut dense = DMatrix::zeros(size, size);
        for (b, list) in lists.iter().enumerate() {
            let half = DMatrix::from_fn(4, 4, |_, _| rng.random_range(-1.0..1.0));
            let block = &half + half.transpose() + DMatrix::identity(4, 4) * shift;
            sparse.add(b, block.as_slice(), 4);
            for (r, &i) in list.iter().enumerate() {
                for (c, &j) in list.iter().enumerate() {
                    if i != HELD && j != HELD {
                        dense[(i, j)] += block[(r, c)];
                    }
                }
            }
        }
        (sparse, dense)
    }

    #[test]
    fn solutions_and_inertia_are_those_of_the_dense_matrix() {
        for shift in [0.0, 1.0, 6.0] {
            let (mut sparse, dense) = chain(23, shift);
            let negative = sparse.factorize().unwrap();
            let eigen = dense.clone().symmetric_eigenvalues();
            assert_eq!(negative, eigen.iter().filter(|&&e| e < 0.0).count());
            let right = DVector::from_fn(sparse.size(), |i, _| (i as f64).sin());
            let mut both = right.as_slice().to_vec();
            both.extend(right.iter().map(|x| -2.0 * x));
            sparse.solve(&mut both);
            let exact = dense.lu().solve(&right).unwrap();
            let (one, two) = both.split_at(sparse.size());
            assert!((DVector::from_column_slice(one) - &exact).norm() < 1e-9 * exact.norm());
            assert!((DVector::from_column_slice(two) + &exact * 2.0).norm() < 1e-9 * exact.norm());
        }
    }

    #[test]
    fn an_unknown_that_stands_in_a_block_twice_gets_both_halves() {
        let mut sparse = Symmetric::new(2, vec![vec![0, 1, 0]], &[0, 1]).unwrap();
        sparse.add(0, &[5.0, 2.0, 1.0, 2.0, 7.0, 3.0, 1.0, 3.0, 6.0], 3);
        assert_eq!(sparse.times(&[1.0, 0.0]), [13.0, 5.0]);
        assert_eq!(sparse.times(&[0.0, 1.0]), [5.0, 7.0]);
    }

    #[test]
    fn every_node_is_eliminated_once_and_separators_late() {
        let blocks: Vec<Vec<usize>> = (0..64)
            .map(|b| {
                let (i, j) = (b % 8, b / 8);
                vec![9 * j + i, 9 * j + i + 1, 9 * j + i + 9, 9 * j + i + 10]
            })
            .collect();
        let centers: Vec<[f64; 3]> = (0..64).map(|b| [(b % 8) as f64, (b / 8) as f64, 0.0]).collect();
        let order = dissect(81, &blocks, &centers);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..81).collect::<Vec<_>>());
        // The last nine are one line across the grid.
        let last: Vec<usize> = order[72..].to_vec();
        assert!(last.iter().all(|n| n % 9 == 4) || last.iter().all(|n| n / 9 == 4));
    }

    #[test]
    fn what_is_singular_or_not_finite_is_refused() {
        let (mut sparse, _) = chain(5, 6.0);
        sparse.clear();
        assert_eq!(sparse.factorize(), Err(SparseError::Singular(15)));
        let block = vec![f64::NAN; 16];
        sparse.add(1, &block, 4);
        assert_eq!(sparse.factorize(), Err(SparseError::Singular(15)));
    }
}
