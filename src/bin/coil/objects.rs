//! What `coil eval` and `coil study` work on: every object under the paths given, made ready one at a time.

use crate::files;
use anyhow::Context;
use coil_ps::dataset::Limits;
use coil_ps::eval::{Protocol, Subject, protocol};
use coil_ps::stack::{RawStack, Stack};
use std::path::Path;

/// An object, ready to plan on.
pub enum Object {
    /// Stored images.
    Stack(Stack),
}

impl Object {
    /// The object as the evaluator takes it.
    pub fn subject(&self) -> Subject<'_> {
        match self {
            Self::Stack(stack) => Subject::Stack(stack),
        }
    }
}

/// Calls `each(name, object)` for every object under `paths`, an unreadable one with its error. With `bear76`
/// DiLiGenT's bear is taken without its first 20 images, and named so.
///
/// # Errors
/// Only those of `each`.
pub fn for_each(
    paths: &[String],
    protocol: Protocol,
    bear76: bool,
    mut each: impl FnMut(&str, anyhow::Result<Object>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let limits = Limits::default();
    for path in paths {
        let source = match files::open(Path::new(path), &limits) {
            Ok(source) => source,
            Err(error) => {
                each(path, Err(error))?;
                continue;
            }
        };
        for dir in &source.objects {
            let object = files::read_object(source.files.as_ref(), dir, &limits)
                .map_err(anyhow::Error::from)
                .and_then(|(raw, warnings)| {
                    for warning in &warnings {
                        eprintln!("{dir}: {warning}");
                    }
                    ready(raw, protocol, bear76)
                });
            let name = object.as_ref().map_or_else(|_| dir.clone(), |stack| stack.name.clone());
            each(&name, object.map(Object::Stack))?;
        }
    }
    Ok(())
}

fn ready(raw: RawStack, protocol: Protocol, bear76: bool) -> anyhow::Result<Stack> {
    let raw = if bear76 && protocol::is_bear(&raw) {
        RawStack { name: "bear76".into(), ..protocol::bear76(&raw) }
    } else {
        raw
    };
    protocol.apply(&raw).with_context(|| format!("protocol {protocol}"))
}
