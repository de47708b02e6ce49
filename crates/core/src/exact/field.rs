//! The integers modulo a prime below 2^30, and what they share with floats.

use crate::error::Error;

/// Primes are below this: a product is then below 2^60, so that 16 of them add up without overflow.
const LIMIT: u32 = 1 << 30;

/// The integers modulo a prime. Residues are from 0 to p - 1.
#[derive(Clone, Copy)]
pub(crate) struct Field {
    pub(crate) prime: u64,
    /// floor(2^64 / p), of Barrett's reduction.
    inverse: u64,
}

impl Field {
    pub(crate) fn new(prime: u32) -> Result<Field, Error> {
        if !(3..LIMIT).contains(&prime) || prime.is_multiple_of(2) {
            return Err(Error::Value { name: "prime", got: prime.into(), wanted: "an odd prime below 2^30" });
        }
        let prime = u64::from(prime);
        Ok(Field { prime, inverse: u64::MAX / prime })
    }

    /// The residue of any number.
    #[inline(always)]
    pub(crate) fn reduce(self, x: u64) -> u64 {
        let quotient = ((u128::from(x) * u128::from(self.inverse)) >> 64) as u64;
        let rest = x - quotient * self.prime; // below 2 p
        if rest >= self.prime { rest - self.prime } else { rest }
    }

    /// The residue of a signed number.
    pub(crate) fn of(self, x: i64) -> u64 {
        x.rem_euclid(self.prime as i64) as u64
    }

    #[inline(always)]
    pub(crate) fn minus(self, x: u64) -> u64 {
        if x == 0 { 0 } else { self.prime - x }
    }

    /// The inverse of a residue that is not zero, by Fermat's little theorem.
    pub(crate) fn invert(self, x: u64) -> u64 {
        let (mut result, mut power, mut exponent) = (1, x, self.prime - 2);
        while exponent > 0 {
            if exponent & 1 == 1 {
                result = self.reduce(result * power);
            }
            power = self.reduce(power * power);
            exponent >>= 1;
        }
        result
    }
}

/// Numbers that can be added and multiplied.
pub(crate) trait Ring: Copy {
    /// As callers have them.
    type Number: Copy;
    /// As they are computed with.
    type Element: Copy + Default;
    const ONE: Self::Element;

    fn element(number: Self::Number) -> Self::Element;

    fn number(element: Self::Element) -> Self::Number;

    fn add(self, a: Self::Element, b: Self::Element) -> Self::Element;

    /// A sum of products less another: `plus` and `minus` have at most eight terms each.
    fn sum<const N: usize, const M: usize>(
        self,
        plus: [(Self::Element, Self::Element); N],
        minus: [(Self::Element, Self::Element); M],
    ) -> Self::Element;
}

impl Ring for Field {
    type Number = i64;
    type Element = u64;
    const ONE: u64 = 1;

    #[inline(always)]
    fn element(number: i64) -> u64 {
        number as u64
    }

    #[inline(always)]
    fn number(element: u64) -> i64 {
        element as i64
    }

    #[inline(always)]
    fn add(self, a: u64, b: u64) -> u64 {
        self.reduce(a + b)
    }

    #[inline(always)]
    fn sum<const N: usize, const M: usize>(self, plus: [(u64, u64); N], minus: [(u64, u64); M]) -> u64 {
        let plus: u64 = plus.iter().map(|(x, y)| x * y).sum();
        let minus: u64 = minus.iter().map(|(x, y)| x * (self.prime - y)).sum();
        self.reduce(plus + minus)
    }
}

/// Floats.
#[derive(Clone, Copy)]
pub(crate) struct Real;

impl Ring for Real {
    type Number = f64;
    type Element = f64;
    const ONE: f64 = 1.0;

    #[inline(always)]
    fn element(number: f64) -> f64 {
        number
    }

    #[inline(always)]
    fn number(element: f64) -> f64 {
        element
    }

    #[inline(always)]
    fn add(self, a: f64, b: f64) -> f64 {
        a + b
    }

    #[inline(always)]
    fn sum<const N: usize, const M: usize>(self, plus: [(f64, f64); N], minus: [(f64, f64); M]) -> f64 {
        let total = |terms: &[(f64, f64)]| terms.iter().map(|(x, y)| x * y).sum::<f64>();
        total(&plus) - total(&minus)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residues_are_those_of_division() {
        let field = Field::new(1_073_741_783).unwrap();
        let p = field.prime;
        for x in [0, 1, p - 1, p, p + 1, 2 * p - 1, p * p, 16 * (p - 1) * (p - 1), u64::MAX - 1, u64::MAX] {
            assert_eq!(field.reduce(x), x % p);
        }
        for x in [1, 2, 12_345, p - 1] {
            assert_eq!(field.reduce(x * field.invert(x)), 1);
        }
        assert!(Field::new(0).is_err() && Field::new(1 << 30).is_err() && Field::new(10).is_err());
    }
}
