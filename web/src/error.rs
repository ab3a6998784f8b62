//! Core errors as JavaScript `Error`s with a stable `code`.

use js_sys::{Error, Reflect};
use landline::front_end::FrontEndError;
use landline::relocalizer::{CreateError, LocateError};
use landline::scene_file::SceneFileError;
use landline::session::SessionError;
use wasm_bindgen::JsValue;

/// The codes that `web/ts/errors.ts` documents.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Code {
    SceneVersion,
    SceneCorrupt,
    SceneExtractor,
    ExtractorCorrupt,
    BadInput,
    EngineDefect,
}

impl Code {
    fn name(self) -> &'static str {
        match self {
            Self::SceneVersion => "scene-version",
            Self::SceneCorrupt => "scene-corrupt",
            Self::SceneExtractor => "scene-extractor",
            Self::ExtractorCorrupt => "extractor-corrupt",
            Self::BadInput => "bad-input",
            Self::EngineDefect => "engine-defect",
        }
    }
}

pub(crate) fn js_error(code: Code, message: &str) -> JsValue {
    let error = Error::new(message);
    // Setting a property of a fresh object cannot fail; the message stays useful even if it did.
    let _set = Reflect::set(&error, &"code".into(), &code.name().into());
    error.into()
}

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
