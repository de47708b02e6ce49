//! Exact arithmetic modulo a prime: row echelon forms, and the regressor at exact states.

pub(crate) mod echelon;
mod field;
pub(crate) mod rows;
