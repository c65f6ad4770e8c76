//! A training run as bytes, and back.
//!
//! Layout: magic, length of a JSON head (recipe, step, best error), head, then 32-bit numbers little endian: weights,
//! both moments, their running average and the best weights if there are any; at the end a fingerprint of all that.

use super::adamw::AdamW;
use super::fit::{Recipe, Trainer};
use super::weights::Weights;
use crate::fingerprint::Fingerprint;
use serde::{Deserialize, Serialize};

const MAGIC: &[u8; 8] = b"coilrun1";

#[derive(Serialize, Deserialize)]
struct Head {
    recipe: Recipe,
    step: u64,
    updates: u64,
    best: Option<f64>,
}

/// Why a checkpoint can't be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CheckpointError {
    /// Not one of ours, or of another version.
    #[error("not a checkpoint of this version of coil")]
    Foreign,
    /// Cut short or changed.
    #[error("the checkpoint is damaged: {0}")]
    Damaged(String),
}

/// The whole state of a run.
///
/// # Panics
/// If the recipe can't be written as JSON: it always can.
#[must_use]
pub fn write(t: &Trainer) -> Vec<u8> {
    let head = Head {
        recipe: t.recipe.clone(),
        step: t.step,
        updates: t.adam.updates,
        best: t.best.as_ref().map(|b| b.1),
    };
    let head = serde_json::to_vec(&head).expect("a recipe is plain data");
    let mut out = MAGIC.to_vec();
    out.extend((head.len() as u64).to_le_bytes());
    out.extend(head);
    let mut numbers = |values: &[f32]| out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    t.weights.params.iter().for_each(|p| numbers(&p.values));
    t.adam.first.iter().chain(&t.adam.second).for_each(|v| numbers(v));
    for weights in t.average.iter().chain(t.best.iter().map(|(best, _)| best)) {
        weights.params.iter().for_each(|p| numbers(&p.values));
    }
    let print = Fingerprint::of(out.iter().copied()).value();
    out.extend(print.to_le_bytes());
    out
}

/// The run that [`write`] saved.
///
/// # Errors
/// [`CheckpointError`].
pub fn read(bytes: &[u8]) -> Result<Trainer, CheckpointError> {
    let damaged = |what: &str| CheckpointError::Damaged(what.into());
    if !bytes.starts_with(MAGIC) {
        return Err(CheckpointError::Foreign);
    }
    let (body, print) = bytes.split_last_chunk::<8>().ok_or_else(|| damaged("too short"))?;
    if Fingerprint::of(body.iter().copied()).value() != u64::from_le_bytes(*print) {
        return Err(damaged("its fingerprint is wrong"));
    }
    let rest = &body[MAGIC.len()..];
    let (length, rest) = rest.split_first_chunk::<8>().ok_or_else(|| damaged("no head"))?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| damaged("no head"))?;
    let (head, rest) = rest.split_at_checked(length).ok_or_else(|| damaged("no head"))?;
    let head: Head = serde_json::from_slice(head).map_err(|e| CheckpointError::Damaged(e.to_string()))?;
    let mut t = Trainer::new(head.recipe).map_err(|e| CheckpointError::Damaged(e.to_string()))?;
    let copies = 3 + usize::from(t.average.is_some()) + usize::from(head.best.is_some());
    let (numbers, tail) = rest.as_chunks::<4>();
    if numbers.len() != copies * t.weights.count() || !tail.is_empty() {
        return Err(damaged("another number of weights than its network has"));
    }
    let mut numbers = numbers.iter().map(|b| f32::from_le_bytes(*b));
    let mut fill = |values: &mut Vec<f32>| values.iter_mut().for_each(|v| *v = numbers.next().unwrap_or(0.0));
    let mut adam = AdamW::new(&t.weights);
    t.weights.params.iter_mut().for_each(|p| fill(&mut p.values));
    adam.first.iter_mut().chain(&mut adam.second).for_each(&mut fill);
    adam.updates = head.updates;
    if let Some(average) = &mut t.average {
        average.params.iter_mut().for_each(|p| fill(&mut p.values));
    }
    if let Some(degrees) = head.best {
        let mut best: Weights = t.weights.clone();
        best.params.iter_mut().for_each(|p| fill(&mut p.values));
        t.best = Some((best, degrees));
    }
    Ok(Trainer { adam, step: head.step, ..t })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damage_is_noticed() {
        let t = Trainer::new(Recipe::compact()).unwrap();
        let good = write(&t);
        assert_eq!(read(&good).unwrap(), t);
        assert_eq!(read(b"PNG"), Err(CheckpointError::Foreign));
        for cut in [9, 40, good.len() - 1] {
            assert!(matches!(read(&good[..cut]), Err(CheckpointError::Damaged(_))), "{cut}");
        }
        let mut flipped = good.clone();
        flipped[good.len() / 2] ^= 1;
        assert!(matches!(read(&flipped), Err(CheckpointError::Damaged(_))));
    }
}
