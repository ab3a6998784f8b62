//! Core errors as JavaScript `Error`s with a stable `code`.

use js_sys::{Error, Reflect};
#[cfg(feature = "locate")]
use landline::{
    front_end::FrontEndError,
    relocalizer::{CreateError, LocateError},
    scene_file::SceneFileError,
    session::SessionError,
};
use wasm_bindgen::JsValue;

/// The codes that `web/ts/errors.ts` documents.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Code {
    #[cfg(feature = "locate")]
    SceneVersion,
    #[cfg(feature = "locate")]
    SceneCorrupt,
    #[cfg(feature = "locate")]
    SceneExtractor,
    ExtractorCorrupt,
    BadInput,
    EngineDefect,
    #[cfg(feature = "map")]
    NotEnoughPictures,
    #[cfg(feature = "map")]
    NoModel,
    #[cfg(feature = "map")]
    Aborted,
}

impl Code {
    fn name(self) -> &'static str {
        match self {
            #[cfg(feature = "locate")]
            Self::SceneVersion => "scene-version",
            #[cfg(feature = "locate")]
            Self::SceneCorrupt => "scene-corrupt",
            #[cfg(feature = "locate")]
            Self::SceneExtractor => "scene-extractor",
            Self::ExtractorCorrupt => "extractor-corrupt",
            Self::BadInput => "bad-input",
            Self::EngineDefect => "engine-defect",
            #[cfg(feature = "map")]
            Self::NotEnoughPictures => "not-enough-pictures",
            #[cfg(feature = "map")]
            Self::NoModel => "no-model",
            #[cfg(feature = "map")]
            Self::Aborted => "aborted",
        }
    }
}

pub(crate) fn js_error(code: Code, message: &str) -> JsValue {
    let error = Error::new(message);
    // Setting a property of a fresh object cannot fail; the message stays useful even if it did.
    let _set = Reflect::set(&error, &"code".into(), &code.name().into());
    error.into()
}

#[cfg(feature = "locate")]
pub(crate) fn from_create(error: &CreateError) -> JsValue {
    let code = match error {
        CreateError::Scene(SceneFileError::Version { .. }) => Code::SceneVersion,
        CreateError::Scene(SceneFileError::WrongExtractor { .. }) => Code::SceneExtractor,
        CreateError::Scene(_) | CreateError::Networks(_) => Code::SceneCorrupt,
        CreateError::Extractor(_) | CreateError::FrontEnd(FrontEndError::Extractor(_)) => {
            Code::ExtractorCorrupt
        }
        _ => Code::BadInput,
    };
    js_error(code, &error.to_string())
}

#[cfg(feature = "locate")]
pub(crate) fn from_session(error: &SessionError) -> JsValue {
    let code = match error {
        // What the caller's frame and options cannot cause is a defect.
        SessionError::Locate(
            LocateError::FrontEnd(FrontEndError::Extractor(_) | FrontEndError::Segments(_))
            | LocateError::Regress(_),
        ) => Code::EngineDefect,
        _ => Code::BadInput,
    };
    js_error(code, &error.to_string())
}
