/** landline/mapper: makes a scene of a film, on the device. */
export { Mapper, packagedMapperWasmUrl } from "./mapper.js";
export type * from "./types.js";
