//! Where the entries of a regressor go, found once for the columns that are asked for again and again.

use crate::error::Error;
use crate::mechanism::Mechanism;
use crate::places::Places;
use crate::regressor::check_columns;
use std::sync::{Arc, Mutex, PoisonError};

/// The entries of all rows and chosen columns, by number: row * chosen + column, set after set.
#[derive(Debug)]
pub(crate) struct Plan {
    columns: Vec<usize>,
    /// Number of entries.
    pub(crate) all: usize,
    /// Entries that can differ from zero, in the order in which they are packed; and those that cannot.
    pub(crate) filled: Vec<usize>,
    pub(crate) empty: Vec<usize>,
    /// Every entry in the run of its own number.
    pub(crate) spread: Vec<Places>,
    /// Filled entries, one run after the other.
    pub(crate) packed: Vec<Places>,
}

impl Plan {
    fn new(mechanism: &Mechanism, sets: usize, columns: &[usize]) -> Plan {
        let (na, p) = (mechanism.coordinates, columns.len());
        let mut chosen = vec![None; mechanism.columns()];
        columns.iter().enumerate().for_each(|(c, &column)| chosen[column] = Some(c));
        let entry = |set: usize, a: usize, column: usize| {
            // With two sets the first one holds the momenta.
            let there = set + 1 == sets || mechanism.has_momentum(column);
            chosen[column].filter(|_| there).map(|c| (set * na + a) * p + c)
        };
        let spread = (0..sets).map(|set| Places::new(mechanism, |a, column| entry(set, a, column))).collect();
        let mut filled = Vec::new();
        let mut packed = |set: usize, a: usize, column: usize| {
            filled.push(entry(set, a, column)?);
            Some(filled.len() - 1)
        };
        let packed = (0..sets).map(|set| Places::new(mechanism, |a, column| packed(set, a, column))).collect();
        let all = sets * na * p;
        let mut empty = vec![true; all];
        filled.iter().for_each(|&entry| empty[entry] = false);
        let empty = (0..all).filter(|&entry| empty[entry]).collect();
        Plan { columns: columns.to_vec(), all, filled, empty, spread, packed }
    }
}

/// The plan that was asked for last; a mechanism that is cloned begins without one.
#[derive(Debug, Default)]
pub(crate) struct Last(Mutex<Option<Arc<Plan>>>);

impl Clone for Last {
    fn clone(&self) -> Last {
        Last::default()
    }
}

impl Mechanism {
    /// The plan of some columns, with one set of rows or two.
    pub(crate) fn plan(&self, sets: usize, columns: &[usize]) -> Result<Arc<Plan>, Error> {
        let mut last = self.last.0.lock().unwrap_or_else(PoisonError::into_inner);
        match last.as_ref().filter(|plan| plan.columns == columns && plan.packed.len() == sets) {
            Some(plan) => Ok(plan.clone()),
            None => {
                check_columns(self, columns)?;
                Ok(last.insert(Arc::new(Plan::new(self, sets, columns))).clone())
            }
        }
    }
}
