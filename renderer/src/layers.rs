//! The layers of a picture, so that a bench can leave some out and see what each costs.

/// A set of layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layers(u32);

impl Layers {
    /// No layer.
    pub const NONE: Layers = Layers(0);
    /// The shadow map.
    pub const SHADOW: Layers = Layers(1);
    /// The retina.
    pub const RETINA: Layers = Layers(2);
    /// The instruments.
    pub const INSTRUMENTS: Layers = Layers(4);
    /// The membrane.
    pub const MEMBRANE: Layers = Layers(8);
    /// Text on the picture.
    pub const TEXT: Layers = Layers(16);
    /// Bodies of abstract tasks and marks.
    pub const BODIES: Layers = Layers(32);
    /// The vitreous.
    pub const HAZE: Layers = Layers(64);
    /// Depth of field.
    pub const FOCUS: Layers = Layers(128);
    /// Every layer.
    pub const ALL: Layers = Layers(u32::MAX);
    /// Each layer with its name.
    pub const EACH: [(&'static str, Layers); 8] = [
        ("shadow", Layers::SHADOW),
        ("retina", Layers::RETINA),
        ("instruments", Layers::INSTRUMENTS),
        ("membrane", Layers::MEMBRANE),
        ("bodies", Layers::BODIES),
        ("haze", Layers::HAZE),
        ("focus", Layers::FOCUS),
        ("text", Layers::TEXT),
    ];

    /// True if it holds all of `others`.
    pub fn has(self, others: Layers) -> bool {
        self.0 & others.0 == others.0
    }

    /// Without `others`.
    pub fn without(self, others: Layers) -> Layers {
        Layers(self.0 & !others.0)
    }
}
