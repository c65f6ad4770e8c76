//! Pictures for a canvas.

use crate::view;
use wasm_bindgen::prelude::*;

/// 8-bit RGBA, as `ImageData` takes it.
#[wasm_bindgen]
pub struct Picture(pub(super) view::Picture);

#[wasm_bindgen]
impl Picture {
    /// Width in pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn width(&self) -> u32 {
        self.0.width
    }

    /// Height in pixels.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn height(&self) -> u32 {
        self.0.height
    }

    /// The bytes, row by row.
    #[wasm_bindgen(getter)]
    #[must_use]
    pub fn rgba(&self) -> Vec<u8> {
        self.0.rgba.clone()
    }
}

/// The colour scale of error maps, from 0 to its end: `width` by 1 pixels.
#[wasm_bindgen(js_name = colourBar)]
#[must_use]
pub fn colour_bar(width: u32) -> Picture {
    Picture(view::colour_bar(width))
}
